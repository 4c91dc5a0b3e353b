"""What the compiled observers share: state as bytes, steps, whole records, batches."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import ObserverError, RecordError, UsageError
from ..logs.record import Record
from .base import Estimate, SampleCounts

Found = TypeVar("Found", bound=Estimate)


@dataclass(frozen=True, eq=False)
class CompiledState:
    """Everything the observer remembers; plain bytes of the C state, one row a lane."""

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
    """What the core returned, by name: (name, components) each, in its order."""
    out, at = {}, 0
    for name, components in names:
        part = columns[at : at + components]
        out[name] = part[0] if components == 1 else np.moveaxis(part, 0, -1)
        at += components
    return out


def wrapped(core: Any, *arguments: Any) -> Any:
    """A compiled core; ObserverError where it refuses its configuration."""
    try:
        return core(*arguments)
    except ValueError as error:
        raise ObserverError(str(error)) from None


class CompiledObserver(Generic[Found]):
    """Steps and runs of an observer whose numbers come from C; its state is plain bytes."""

    _core: Any

    if TYPE_CHECKING:  # a field of one observer, a property of the other

        @property
        def sample_time(self) -> float:
            """[s]."""

    def _estimate(self, columns: NDArray[np.float64], valid: NDArray[np.bool_]) -> Found:
        raise NotImplementedError

    def init(self, batch: tuple[int, ...] = ()) -> CompiledState:
        """State of which nothing is known, for one record or a batch of that shape."""
        lanes = int(np.prod(batch, dtype=int))
        return CompiledState(self._core.reset(lanes), tuple(batch))

    def step(
        self,
        state: CompiledState,
        voltage: ArrayLike | None = None,
        current: ArrayLike | None = None,
        *,
        volt_seconds: ArrayLike | None = None,
    ) -> tuple[CompiledState, Found]:
        """One sample.

        Parameters
        ----------
        state : CompiledState
            Not changed.
        voltage : (*batch, 2) array_like
            Mean voltage over the interval ending now [V]; NaN where missing.
        current : (*batch, 2) array_like
            Current sampled now [A]; NaN where missing.
        volt_seconds : (*batch, 2) array_like, instead of voltage
            ∫ (-R i_m + B u_m) dt over the interval ending now [Wb], where known exactly.

        Returns
        -------
        state : CompiledState
        estimate : Estimate
            Leading shape `batch`.
        """
        source = _source(voltage, volt_seconds)
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
    ) -> tuple[CompiledState, Found]:
        """Like :meth:`run` on arrays, from `state`; returns the state after the last row too."""
        source = np.ascontiguousarray(_source(voltage, volt_seconds), dtype=float)
        i = np.ascontiguousarray(current, dtype=float)
        if i.ndim < 2 or i.shape[-1] != 2 or source.shape != i.shape or i.shape[:-2] != state.batch:
            raise RecordError(
                f"voltage and current must have shape {(*state.batch, 'rows', 2)}, "
                f"got {source.shape} and {i.shape}"
            )
        return self._advance(state, source, i, volt_seconds is not None, threads or _processors())

    def counts(self, state: CompiledState, lane: int = 0) -> SampleCounts:
        """Bad samples and restarts that `state` (one lane of it) has seen."""
        return SampleCounts(*self._core.counters(state.raw, lane))

    def _advance(
        self,
        state: CompiledState,
        source: NDArray[np.float64],
        current: NDArray[np.float64],
        volt_seconds: bool,
        threads: int,
        squeeze: bool = False,
    ) -> tuple[CompiledState, Found]:
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
        return CompiledState(raw, state.batch), found


def _source(voltage: ArrayLike | None, volt_seconds: ArrayLike | None) -> ArrayLike:
    if (voltage is None) == (volt_seconds is None):
        raise UsageError("give either voltage or volt_seconds")
    return voltage if voltage is not None else volt_seconds  # type: ignore[return-value]


def _processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
