"""The interface of an observer, and what it returns."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.arrays import Array
from .outputs import documented, output


@documented
@dataclass(frozen=True, eq=False)
class Estimate:
    """What an observer returns for one sample (leading shape ``()``), a record or a batch."""

    flux: Array = field(
        metadata=output(
            "Wb",
            "Flux linkage. A current bias δ_i adds L δ_i to it (theory, section 3)",
            vector=True,
        )
    )
    psi_f: Array = field(
        metadata=output(
            "Wb", "Length of the position vector λ - L i: magnet flux, or active flux if salient"
        )
    )
    theta_e: Array = field(
        metadata=output(
            "rad",
            "Electrical position directly from the flux, in (-π, π]; always finite",
        )
    )
    theta_e_tracked: Array = field(metadata=output("rad", "Tracked position, in (-π, π]"))
    speed_e: Array = field(metadata=output("rad/s", "Electrical speed"))
    drift: Array = field(
        metadata=output(
            "V", "R δ_i - B δ_u, the rate at which the open-loop flux integral drifts", vector=True
        )
    )
    theta_e_std: Array = field(
        metadata=output(
            "rad", "Standard deviation of theta_e; π/√3 (uniform over a turn) if nothing is known"
        )
    )
    valid: NDArray[np.bool_] = field(metadata=output("", "The position is known now", boolean=True))
    innovation: Array = field(
        metadata=output(
            "",
            "Residual of the constraint over its assumed noise, before the update",
            in_files=False,
        )
    )
    noise_share: Array = field(
        metadata=output(
            "", "Share of the flux information that is only noise; 1: no position", in_files=False
        )
    )


@dataclass(frozen=True)
class SampleCounts:
    """How many samples were bad so far, and how often the observer restarted.

    Attributes
    ----------
    bad_voltages, bad_currents : int
        Samples that are not finite.
    absurd : int
        Samples with a value that no such machine can have.
    outliers : int
        Currents that contradict all earlier samples; not used.
    restarts : int
        Restarts after an absurd value, or after more than three bad samples in a row.
    outside : int
        Rows, of those with a known position, whose current is outside the machine's flux map.
    """

    bad_voltages: int
    bad_currents: int
    absurd: int
    outliers: int
    restarts: int
    outside: int = 0


State = TypeVar("State")
Found = TypeVar("Found", covariant=True)


class Observer(Protocol[State, Found]):
    """The protocol of every observer: the state is data, the observer a frozen object.

    `step` takes the current sampled now and the mean voltage over the interval that ends now; `run`
    gives the same numbers for a whole record. Nothing is mutated. Vectors are (2,) or (rows, 2), in
    NumPy or JAX, whichever the observer uses. tests/contract checks every observer against this:
    the compiled ones, the immersed one, their twin in JAX, and the baselines of the comparison.
    """

    @property
    def sample_time(self) -> Any:
        """[s]."""
        ...

    def init(self) -> State:
        """Initial state, in which nothing is known."""
        ...

    def step(self, state: State, voltage: Any, current: Any) -> tuple[State, Found]:
        """Process one sample [V], [A]."""
        ...

    def run(self, voltage: Any, current: Any) -> Any:
        """Process a record from the initial state; returns the estimates of all rows, stacked."""
        ...


class LogObserver(Observer[State, Found], Protocol[State, Found]):
    """An observer for logs: it takes a log in parts, and counts bad samples."""

    @property
    def memory(self) -> float:
        """Exponential memory [s]."""
        ...

    def resume(self, state: State, voltage: ArrayLike, current: ArrayLike) -> tuple[State, Any]:
        """Like `run`, from `state`; returns the state after the last row too."""
        ...

    def counts(self, state: State) -> SampleCounts:
        """Bad samples and restarts so far."""
        ...
