"""Records: measured data in memory, and the interval over which each voltage acts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..core.arrays import Array
from ..errors import RecordError
from ..machines.model.frames import clarke

#: Voltage lags that occur in practice, relative to the given lag [samples].
LAGS = (-2, -1, 0, 1, 2)
#: Sample times of record and observer may differ by this share, because clocks are inaccurate.
SAMPLE_TIME_TOLERANCE = 1e-3


def signed(lag: float) -> str:
    """Return a lag as text."""
    return f"{lag:+g}" if lag else "0"


def interval_rows(rows: Array, lag: float, first: int, last: int, start: int = 0) -> Array:
    """Return the voltage over the intervals that end at rows first … last - 1.

    The voltage of the interval [t_{k-1}, t_k] is read at row ``k - 1 + lag``, interpolated linearly
    if this number is fractional. Outside `rows`, the voltage is NaN, never extrapolated.

    Parameters
    ----------
    rows : (m, 2) ndarray
        Voltage as recorded, rows start … start + m - 1 of the record.
    lag : float
        In samples. With lag 0, row k acts from t_k to t_{k+1}; with lag -1, one sample later.
    first, last, start : int
        Row numbers of the record.

    Returns
    -------
    (last - first, 2) ndarray
    """
    whole = int(np.floor(lag))
    fraction = lag - whole
    lower = np.arange(first, last) - 1 + whole - start
    voltage = np.full((last - first, rows.shape[1]), np.nan)
    inside = (lower >= 0) & (lower + (fraction > 0) < len(rows))
    lower = lower[inside]
    if fraction > 0:
        voltage[inside] = (1 - fraction) * rows[lower] + fraction * rows[lower + 1]
    else:
        voltage[inside] = rows[lower]
    return voltage


@dataclass(frozen=True, eq=False)
class Record:
    """Currents and voltages in αβ, sampled uniformly.

    Parameters
    ----------
    sample_time : float
        [s], > 0.
    voltage, current : array_like
        As logged [V], [A]; NaN where missing. The shape is (rows, 2) in αβ, (rows, 3) for three
        phases, or (rows,) for complex α + j β. Stored as (rows, 2) in αβ, amplitude-invariant.
    lag : float, optional
        Interval over which a row's voltage acts, in samples; see :func:`interval_rows`. Without it,
        :func:`fluxobs.estimate` learns it, from -2 to +1; everything else uses 0.
    theta_e : (rows,) array_like, optional
        True electrical angle [rad], to score estimates.

    Raises
    ------
    RecordError
        Shapes do not match, or the lag exceeds the record.

    Examples
    --------
    >>> import numpy as np
    >>> u, i = np.zeros((100, 3)), np.zeros(100, complex)
    >>> Record(1e-4, u, i, lag=-1).voltage.shape
    (100, 2)
    """

    sample_time: float
    voltage: Array
    current: Array
    lag: float | None = None
    theta_e: Array | None = None

    def __post_init__(self) -> None:
        if not (np.isfinite(self.sample_time) and self.sample_time > 0):
            raise RecordError(f"sample_time must be positive [s], got {self.sample_time}")
        for name in ("voltage", "current"):
            object.__setattr__(self, name, alphabeta_rows(name, getattr(self, name)))
        if self.voltage.shape != self.current.shape:
            raise RecordError(
                f"voltage and current must have the same number of rows, got "
                f"{len(self.voltage)} and {len(self.current)}"
            )
        if self.theta_e is not None:
            theta = np.asarray(self.theta_e, dtype=float)
            if theta.shape != self.current.shape[:1]:
                raise RecordError(
                    f"theta_e must have shape ({len(self.current)},), got {theta.shape}"
                )
            object.__setattr__(self, "theta_e", theta)
        check_lag(self.lag or 0.0, len(self.current))

    def __len__(self) -> int:
        return len(self.current)

    @property
    def t(self) -> Array:
        """Time of the rows [s], starting at 0."""
        return np.asarray(np.arange(len(self)) * self.sample_time)

    def interval_voltage(self) -> Array:
        """Return the mean voltage of the interval ending at each row, shape (rows, 2) [V].

        The voltage is NaN where it is unknown.
        """
        return interval_rows(self.voltage, self.lag or 0.0, 0, len(self))

    def on_intervals(self, sample_time: float) -> tuple[Array, Array]:
        """Return interval voltage and current for an observer with this sample time.

        Raises
        ------
        RecordError
            The record has a different sample time.
        """
        if not np.isclose(self.sample_time, sample_time, rtol=SAMPLE_TIME_TOLERANCE):
            raise RecordError(
                f"the record's sample time is {self.sample_time:g} s, but the observer's is "
                f"{sample_time:g} s: create the observer with the record's sample time"
            )
        return self.interval_voltage(), self.current


def check_lag(lag: float, rows: int) -> None:
    """Raise RecordError if a lag is not a number or leaves no voltage inside the record."""
    if not np.isfinite(lag):
        raise RecordError(f"lag must be a number of samples, got {lag}")
    if abs(lag) >= rows - 1:
        raise RecordError(
            f"a lag of {lag:g} samples lies outside the record of {rows} rows; -1 to +1 is usual"
        )


def alphabeta_rows(name: str, value: ArrayLike) -> Array:
    """Convert αβ, three phases or complex numbers to vectors in αβ of shape (rows, 2).

    Raises
    ------
    RecordError
        The shape does not fit, or the values are not numbers.
    """
    try:
        array = np.asarray(value)
        array = array if np.iscomplexobj(array) else np.asarray(array, dtype=float)
    except (TypeError, ValueError) as error:
        raise RecordError(f"{name} must hold numbers: {error}") from None
    if np.iscomplexobj(array) and array.ndim == 1:
        return np.stack([array.real, array.imag], axis=-1)
    if not np.iscomplexobj(array) and array.ndim == 2:
        if array.shape[1] == 2:
            return array
        if array.shape[1] == 3:
            return clarke(*array.T)
    raise RecordError(
        f"{name} must have shape (rows, 2) in αβ, (rows, 3) of three phases, or (rows,) complex, "
        f"got {array.shape}{' complex' if np.iscomplexobj(array) else ''}"
    )
