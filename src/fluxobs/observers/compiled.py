"""What the compiled observers share: state as bytes, steps, whole records, batches."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..records import Record
from .base import Estimate

Found = TypeVar("Found", bound=Estimate)


@dataclass(frozen=True, eq=False)
class LeastSquaresState:
    """Everything the observer remembers; plain bytes of the C state, one row a lane."""

    raw: NDArray[np.uint8]
    batch: tuple[int, ...]

    def __post_init__(self) -> None:
        self.raw.setflags(write=False)

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, LeastSquaresState)
            and self.batch == other.batch
            and np.array_equal(self.raw, other.raw)
        )

    __hash__ = None  # type: ignore[assignment]


@dataclass(frozen=True)
class SampleCounts:
    """What was wrong with the samples so far, and how often the information was restarted.

    Attributes
    ----------
    bad_voltages, bad_currents : int
        Not finite.
    absurd : int
        No such machine can have such a value.
    outliers : int
        Currents that contradict all samples before; not used.
    restarts : int
        After an absurd value, or more than three bad samples in a row.
    """

    bad_voltages: int
    bad_currents: int
    absurd: int
    outliers: int
    restarts: int


def position_columns(columns: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """What every compiled observer returns first, by the names of :class:`Estimate`."""
    return {
        "flux": np.moveaxis(columns[0:2], 0, -1),
        "psi_f": columns[2],
        "theta_e": columns[3],
        "theta_e_tracked": columns[4],
        "speed_e": columns[5],
        "drift": np.moveaxis(columns[6:8], 0, -1),
        "theta_e_std": columns[8],
        "innovation": columns[9],
        "noise_share": columns[10],
    }


class CompiledObserver(Generic[Found]):
    """Steps and runs of an observer whose numbers come from C; its state is plain bytes."""

    sample_time: float
    _core: Any

    def _estimate(self, columns: NDArray[np.float64], valid: NDArray[np.bool_]) -> Found:
        raise NotImplementedError

    def init(self, batch: tuple[int, ...] = ()) -> LeastSquaresState:
        """State of which nothing is known, for one record or a batch of that shape."""
        return LeastSquaresState(self._core.reset(int(np.prod(batch, dtype=int))), tuple(batch))

    def step(
        self,
        state: LeastSquaresState,
        voltage: ArrayLike | None = None,
        current: ArrayLike | None = None,
        *,
        volt_seconds: ArrayLike | None = None,
    ) -> tuple[LeastSquaresState, Found]:
        """One sample.

        Parameters
        ----------
        state : LeastSquaresState
            Not changed.
        voltage : (*batch, 2) array_like
            Mean voltage over the interval ending now [V]; NaN where missing.
        current : (*batch, 2) array_like
            Current sampled now [A]; NaN where missing.
        volt_seconds : (*batch, 2) array_like, instead of voltage
            ∫ (-R i_m + B u_m) dt over the interval ending now [Wb], where known exactly.

        Returns
        -------
        state : LeastSquaresState
        estimate : Estimate
            Leading shape `batch`.
        """
        source = _source(voltage, volt_seconds)
        if current is None:
            raise TypeError("current is missing")
        expected = (*state.batch, 2)
        source, i = np.asarray(source, float), np.asarray(current, float)
        if source.shape != expected or i.shape != expected:
            raise ValueError(
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
    ) -> Found:
        """A whole record, or a batch of arrays, from zero knowledge; releases the GIL.

        Same numbers, bit for bit, as the step loop. To go on from a state, see :meth:`resume`.

        Parameters
        ----------
        voltage : Record or (*batch, rows, 2) array_like
            A record, whose lag decides which voltage belongs to which interval; or, with
            `current`, an array whose row k is the mean over the interval that ends at row k [V].
        current : (*batch, rows, 2) array_like
            [A].
        volt_seconds : (*batch, rows, 2) array_like, instead of voltage
            [Wb].
        threads : int, optional
            For a batch; default one a processor.

        Returns
        -------
        Estimate
            Leading shape ``(*batch, rows)``.
        """
        if isinstance(voltage, Record):
            record = voltage
            if not np.isclose(record.sample_time, self.sample_time, rtol=1e-3):
                raise ValueError(
                    f"the record's sample time, {record.sample_time:g} s, is not the observer's, "
                    f"{self.sample_time:g} s"
                )
            voltage, current = record.interval_voltage(), record.current
        if current is None:
            raise TypeError("give a record, or current with voltage or volt_seconds")
        state = self.init(np.shape(current)[:-2])
        return self.resume(state, voltage, current, volt_seconds=volt_seconds, threads=threads)[1]

    def resume(
        self,
        state: LeastSquaresState,
        voltage: ArrayLike | None = None,
        current: ArrayLike | None = None,
        *,
        volt_seconds: ArrayLike | None = None,
        threads: int | None = None,
    ) -> tuple[LeastSquaresState, Found]:
        """Like :meth:`run` on arrays, from `state`; returns the state after the last row too."""
        source = np.ascontiguousarray(_source(voltage, volt_seconds), dtype=float)
        i = np.ascontiguousarray(current, dtype=float)
        if i.ndim < 2 or i.shape[-1] != 2 or source.shape != i.shape or i.shape[:-2] != state.batch:
            raise ValueError(
                f"voltage and current must have shape {(*state.batch, 'rows', 2)}, "
                f"got {source.shape} and {i.shape}"
            )
        return self._advance(state, source, i, volt_seconds is not None, threads or _processors())

    def counts(self, state: LeastSquaresState, lane: int = 0) -> SampleCounts:
        """Bad samples and restarts that `state` (one lane of it) has seen."""
        return SampleCounts(*self._core.counters(state.raw, lane))

    def _advance(
        self,
        state: LeastSquaresState,
        source: NDArray[np.float64],
        current: NDArray[np.float64],
        volt_seconds: bool,
        threads: int,
        squeeze: bool = False,
    ) -> tuple[LeastSquaresState, Found]:
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
        found = self._estimate(columns.reshape(len(columns), *shape), valid.reshape(shape))
        return LeastSquaresState(raw, state.batch), found


def _source(voltage: ArrayLike | None, volt_seconds: ArrayLike | None) -> ArrayLike:
    if (voltage is None) == (volt_seconds is None):
        raise TypeError("give either voltage or volt_seconds")
    return voltage if voltage is not None else volt_seconds  # type: ignore[return-value]


def _processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
