"""Base class of the compiled observers: it processes samples, whole records and batches."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.validation import number
from ..errors import ObserverError, RecordError, UsageError
from ..logs.record import Record
from .base import Estimate, SampleCounts

EstimateType = TypeVar("EstimateType", bound=Estimate)


@dataclass(frozen=True, eq=False)
class CompiledState:
    """State of a compiled observer: the bytes of the C state, one row per lane."""

    raw: NDArray[np.uint8]
    batch: tuple[int, ...]

    def __post_init__(self) -> None:
        self.raw.setflags(write=False)

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, CompiledState)
            and self.batch == other.batch
            and np.array_equal(self.raw, other.raw)
        )

    __hash__ = None  # type: ignore[assignment]


def read_columns(
    names: Sequence[tuple[str, int]], columns: NDArray[np.float64]
) -> dict[str, NDArray[np.float64]]:
    """Return the core's outputs by name; `names` lists (name, components) in the core's order."""
    outputs, row = {}, 0
    for name, components in names:
        values = columns[row : row + components]
        outputs[name] = values[0] if components == 1 else np.moveaxis(values, 0, -1)
        row += components
    return outputs


def make_core(core: Any, *arguments: Any) -> Any:
    """Make a compiled core; raise ObserverError if the core refuses the configuration."""
    try:
        return core(*arguments)
    except ValueError as error:
        raise ObserverError(str(error)) from None


class CompiledObserver(Generic[EstimateType]):
    """An observer computed in C, whose state is plain bytes."""

    _core: Any

    if TYPE_CHECKING:  # one subclass has a field, the other a property

        @property
        def sample_time(self) -> float:
            """Sample time [s]."""

    def _estimate(self, columns: NDArray[np.float64], valid: NDArray[np.bool_]) -> EstimateType:
        raise NotImplementedError

    def seed(
        self,
        theta_e: float,
        current: ArrayLike,
        *,
        theta_e_std: float,
        speed_e: float = 0.0,
        psi_f: float = 0.0,
        psi_f_std: float = 0.0,
        weight_other: float = 0.0,
        state: CompiledState | None = None,
    ) -> CompiledState:
        """Return a state that starts at a known angle: from Hall sensors, an alignment, an encoder.

        The seeded angle is propagated with a growing standard deviation. When the standard
        deviation of the least squares becomes smaller, their angle is used. This happens earlier
        than without a seed. The conditions of `valid` do not change. The filter of an adaptive
        observer runs at once if the angle is known to ten degrees.

        Parameters
        ----------
        theta_e, theta_e_std : float
            Angle at the present sample, in (-π, π], and its standard deviation [rad], which is 0.3
            for a sector of Hall sensors.
        current : (2,) array_like
            Current of that sample [A].
        speed_e : float
            Electrical speed [rad/s].
        psi_f, psi_f_std : float
            Length of the position vector and its standard deviation [Wb]. The length is negative if
            the vector points backwards. A length of 0 means the flux base; a standard deviation of
            0 means a quarter of the length.
        weight_other : float
            Weight of the angle half a turn away, 0 to 0.5, for the adaptive observer: without
            motion, a rotor's axis is known, but not its polarity.
        state : CompiledState, optional
            For the adaptive observer: a state whose learnt parameters are kept.

        Raises
        ------
        UsageError
            A number is missing, is not finite or has the wrong sign, or `state` is the state of a
            batch.
        """
        numbers = {
            # A value from an estimate has shape ().
            name: number(name, np.asarray(value)[()], unit)
            for name, value, unit in (
                ("theta_e", theta_e, "rad"),
                ("theta_e_std", theta_e_std, "rad"),
                ("speed_e", speed_e, "rad/s"),
                ("psi_f", psi_f, "Wb"),
                ("psi_f_std", psi_f_std, "Wb"),
                ("weight_other", weight_other, "1"),
            )
        }
        current_now = np.ascontiguousarray(current, dtype=float)
        if current_now.shape != (2,):
            raise UsageError(
                f"current must have shape (2,), alpha and beta; got {current_now.shape}"
            )
        for name, values in {**numbers, "current": current_now}.items():
            if not np.isfinite(np.asarray(values)).all():
                raise UsageError(f"{name} must be finite, got {values}")
        if not numbers["theta_e_std"] > 0:
            raise UsageError(f"theta_e_std must be positive, got {theta_e_std:g} rad")
        if numbers["psi_f_std"] < 0:
            raise UsageError(f"psi_f_std must not be negative, got {psi_f_std:g} Wb")
        if not 0 <= numbers["weight_other"] <= 0.5:
            raise UsageError(f"weight_other must be within 0 and 0.5, got {weight_other:g}")
        if state is not None and state.batch:
            raise UsageError(
                f"state must be that of one record, got a batch of shape {state.batch}"
            )
        numbers["theta_e"] = float(np.angle(np.exp(1j * numbers["theta_e"])))
        return CompiledState(self._seed(numbers, current_now, state or self.init()), ())

    def _seed(
        self, numbers: dict[str, float], current: NDArray[np.float64], state: CompiledState
    ) -> NDArray[np.uint8]:
        raise NotImplementedError

    def init(self, batch: tuple[int, ...] = ()) -> CompiledState:
        """Return the initial state without information, for a record or a batch of this shape."""
        lanes = int(np.prod(batch, dtype=int))
        return CompiledState(self._core.reset(lanes), tuple(batch))

    def step(
        self,
        state: CompiledState,
        voltage: ArrayLike | None = None,
        current: ArrayLike | None = None,
        *,
        volt_seconds: ArrayLike | None = None,
    ) -> tuple[CompiledState, EstimateType]:
        """Process one sample.

        Parameters
        ----------
        state : CompiledState
            The state before the sample; it does not change.
        voltage : (*batch, 2) array_like
            Mean voltage over the interval ending now [V]; NaN where missing.
        current : (*batch, 2) array_like
            Current sampled now [A]; NaN where missing.
        volt_seconds : (*batch, 2) array_like, instead of voltage
            Exact ∫ (-R i_m + B u_m) dt over the interval ending now [Wb].

        Returns
        -------
        state : CompiledState
        estimate : Estimate
            Leading shape `batch`.
        """
        source = _source(voltage, volt_seconds)
        _check_state(state)
        if current is None:
            raise UsageError("current is missing: give voltage (or volt_seconds) and current")
        expected = (*state.batch, 2)
        source, i = np.asarray(source, float), np.asarray(current, float)
        if source.shape != expected or i.shape != expected:
            raise RecordError(
                f"voltage and current must have shape {expected}, got {source.shape} and {i.shape}"
            )
        return self._advance(
            state, source[..., None, :], i[..., None, :], volt_seconds is not None, 1, squeeze=True
        )

    def run(
        self,
        voltage: Record | ArrayLike | None = None,
        current: ArrayLike | None = None,
        *,
        volt_seconds: ArrayLike | None = None,
        threads: int | None = None,
    ) -> EstimateType:
        """Process a whole record, or a batch of arrays, from the initial state; release the GIL.

        The results are bit for bit those of a loop of steps. :meth:`resume` continues from a state.

        Parameters
        ----------
        voltage : Record or (*batch, rows, 2) array_like
            A record, whose lag assigns voltages to intervals. Or an array, given with `current`:
            row k is the mean over the interval that ends at row k [V].
        current : (*batch, rows, 2) array_like
            Current at each row [A].
        volt_seconds : (*batch, rows, 2) array_like, instead of voltage
            Exact volt-seconds, as for :meth:`step` [Wb].
        threads : int, optional
            Threads for a batch; default: one per processor.

        Returns
        -------
        Estimate
            Leading shape ``(*batch, rows)``.
        """
        if isinstance(voltage, Record):
            voltage, current = voltage.on_intervals(self.sample_time)
        if current is None:
            raise UsageError("give a record, or current with voltage or volt_seconds")
        state = self.init(np.shape(current)[:-2])
        return self.resume(state, voltage, current, volt_seconds=volt_seconds, threads=threads)[1]

    def resume(
        self,
        state: CompiledState,
        voltage: ArrayLike | None = None,
        current: ArrayLike | None = None,
        *,
        volt_seconds: ArrayLike | None = None,
        threads: int | None = None,
    ) -> tuple[CompiledState, EstimateType]:
        """Process arrays from `state`, like :meth:`run`; return (last state, estimates)."""
        _check_state(state)
        source = np.ascontiguousarray(_source(voltage, volt_seconds), dtype=float)
        i = np.ascontiguousarray(current, dtype=float)
        if i.ndim < 2 or i.shape[-1] != 2 or source.shape != i.shape or i.shape[:-2] != state.batch:
            expected = ", ".join(map(str, (*state.batch, "rows", 2)))
            raise RecordError(
                f"voltage and current must have shape ({expected}), got {source.shape} and "
                f"{i.shape}"
            )
        return self._advance(state, source, i, volt_seconds is not None, threads or _processors())

    def counts(self, state: CompiledState, lane: int = 0) -> SampleCounts:
        """Return the numbers of bad samples and restarts in one lane of `state`."""
        return SampleCounts(*self._core.counters(state.raw, lane))

    def _advance(
        self,
        state: CompiledState,
        source: NDArray[np.float64],
        current: NDArray[np.float64],
        volt_seconds: bool,
        threads: int,
        squeeze: bool = False,
    ) -> tuple[CompiledState, EstimateType]:
        rows = current.shape[-2]
        lanes = state.raw.shape[0]
        raw, columns, valid = self._core.run(
            state.raw,
            source.reshape(lanes, rows, 2),
            current.reshape(lanes, rows, 2),
            volt_seconds,
            threads,
        )
        shape = state.batch if squeeze else (*state.batch, rows)
        estimate = self._estimate(columns.reshape(len(columns), *shape), valid.reshape(shape))
        return CompiledState(raw, state.batch), estimate


def _check_state(state: object) -> None:
    if not isinstance(state, CompiledState):
        raise UsageError(f"state must come from init or step, got {type(state).__name__}")


def _source(voltage: ArrayLike | None, volt_seconds: ArrayLike | None) -> ArrayLike:
    if (voltage is None) == (volt_seconds is None):
        raise UsageError("give either voltage or volt_seconds")
    return voltage if voltage is not None else volt_seconds  # type: ignore[return-value]


def _processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
