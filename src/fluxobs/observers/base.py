"""The interface of an observer, and its estimate."""

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
    """Estimate for one sample (leading shape ``()``), a record or a batch."""

    flux: Array = field(
        metadata=output(
            "Wb",
            "Flux linkage. A current bias δ_i adds L δ_i to the flux (theory, section 3)",
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
            "Electrical position computed from the flux, in (-π, π]; always finite",
        )
    )
    theta_e_tracked: Array = field(metadata=output("rad", "Tracked position, in (-π, π]"))
    speed_e: Array = field(metadata=output("rad/s", "Electrical speed"))
    drift: Array = field(
        metadata=output(
            "V", "R δ_i - B δ_u: the rate at which the open-loop flux integral drifts", vector=True
        )
    )
    theta_e_std: Array = field(
        metadata=output(
            "rad", "Standard deviation of theta_e; π/√3 (uniform over a turn) without information"
        )
    )
    valid: NDArray[np.bool_] = field(
        metadata=output("", "The position is known, and theta_e_std is reliable", boolean=True)
    )
    innovation: Array = field(
        metadata=output(
            "",
            "Residual of the constraint before the update, divided by its assumed noise",
            in_files=False,
        )
    )
    noise_share: Array = field(
        metadata=output(
            "", "Share of noise in the flux information; 1 means no position", in_files=False
        )
    )


@dataclass(frozen=True)
class SampleCounts:
    """Numbers of bad samples and of restarts so far.

    Attributes
    ----------
    bad_voltages, bad_currents : int
        Samples that are not finite.
    absurd : int
        Samples with an implausible value.
    outliers : int
        Currents that contradict all earlier samples; they are ignored.
    restarts : int
        Restarts after an implausible value, or after more than three bad samples in a row.
    outside : int
        Rows with a known position whose current is outside the machine's flux map.
    """

    bad_voltages: int
    bad_currents: int
    absurd: int
    outliers: int
    restarts: int
    outside: int = 0


State = TypeVar("State")
EstimateType = TypeVar("EstimateType", covariant=True)


class Observer(Protocol[State, EstimateType]):
    """Protocol of all observers: the state is data, and the observer is a frozen object.

    `step` takes the current sampled now and the mean voltage over the interval that ends now; `run`
    returns the same numbers for a whole record. No argument is mutated. Vectors have shape (2,) or
    (rows, 2); they are arrays of NumPy or JAX, depending on the observer. tests/contract checks all
    observers: the compiled observers, the immersed observer, their twin in JAX, and the baselines
    of the comparison.
    """

    @property
    def sample_time(self) -> Any:
        """Sample time [s]."""
        ...

    def init(self) -> State:
        """Return the initial state, which holds no information."""
        ...

    def step(self, state: State, voltage: Any, current: Any) -> tuple[State, EstimateType]:
        """Process one sample: mean voltage [V] and current [A]."""
        ...

    def run(self, voltage: Any, current: Any) -> Any:
        """Process a record from the initial state; return the stacked estimates of all rows."""
        ...


class LogObserver(Observer[State, EstimateType], Protocol[State, EstimateType]):
    """An observer for logs: it processes a log in batches and counts bad samples."""

    @property
    def memory(self) -> float:
        """Exponential memory [s]."""
        ...

    def resume(self, state: State, voltage: ArrayLike, current: ArrayLike) -> tuple[State, Any]:
        """Process a record from `state`; return the state after the last row and the estimates."""
        ...

    def counts(self, state: State) -> SampleCounts:
        """Return the numbers of bad samples and restarts so far."""
        ...
