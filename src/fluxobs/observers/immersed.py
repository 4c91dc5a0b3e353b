"""Least squares on the immersion in Python: any number of ports and relations, and current bias.

firmware/fluxobs.c has the same recursion for one relation, two ports and unknown drift. This module
is written to be read, and its conditions for `valid` are simpler.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.arrays import Array
from ..errors import ObserverError, RecordError, UsageError
from ..logs.record import Record
from ..machines.model.immersion import Immersion
from .base import SampleCounts
from .outputs import documented, output
from .requirements import (
    finite_matrix,
    positive_vector,
    require_memory,
    require_not_negative,
    require_positive,
)
from .thresholds import CORRELATION_LIMIT, MISSING, NOISE_SHARE_LIMIT

#: A flux is known if its standard deviation is below this share of the flux, per-unit. The share is
#: 3° of the angle of a rotor's flux, as in the compiled observer (STD_LIMIT).
KNOWN = 0.05
#: A sample whose innovation exceeds this many standard deviations contradicts all earlier samples.
#: Noise does not reach ten; a jump of an offset reaches ten within a few samples (tests/observers).
CONTRADICTION = 10.0
#: After this many contradictions in a row, a constant must have jumped, and the observer restarts.
#: Fewer contradictions may be a burst of spikes, which the compiled observer also bridges.
CONTRADICTIONS = MISSING
#: A restart multiplies the innovations' power by this factor. Noise above the assumed noise then
#: cannot cause restarts for ever: four restarts compensate an assumed noise 16 times too small.
RESTART_POWER = 4.0
#: A current bias beyond this many standard deviations of its prior is an artefact of noise. Such a
#: bias corrupts the flux, which is then not valid.
BIAS_LIMIT = 3.0
#: A current bias is identified if its standard deviation falls below this share of its prior
#: standard deviation. The share is 1 without data, and 0.7 for each of two ports if one direction
#: is hidden.
UNSEEN_BIAS = 0.25
#: Samples between two prior re-injections, each of one row, as in the compiled observer.
REINJECTION_INTERVAL = 2
#: Weights of the last four currents, newest first. The weights give the mean of the cubic through
#: these currents over the last interval.
QUADRATURE = np.array([9.0, 19.0, -5.0, 1.0]) / 24


@documented
@dataclass(frozen=True, eq=False)
class ImmersionEstimate:
    """Estimate for one sample (leading shape ``()``) or a record ``(rows,)``.

    With n ports and r relations, vectors are (..., n), and the innovation is (..., r).
    """

    flux: Array = field(metadata=output("Wb", "Flux linkage", vector=True))
    flux_std: Array = field(metadata=output("Wb", "Standard deviation of flux", vector=True))
    drift: Array = field(metadata=output("V", "R δ_i - B δ_u", vector=True))
    drift_std: Array = field(
        metadata=output("V", "Standard deviation of drift", vector=True, in_files=False)
    )
    current_bias: Array = field(
        metadata=output("A", "Offset of the current; 0 if it is not an unknown", vector=True)
    )
    current_bias_std: Array = field(
        metadata=output("A", "Standard deviation of current_bias", vector=True)
    )
    noise_share: Array = field(
        metadata=output("", "Share of noise in the information on each flux component", vector=True)
    )
    valid: NDArray[np.bool_] = field(
        metadata=output(
            "",
            "The flux is known: noise share below 0.1 and standard deviation below a twentieth of "
            "the flux, per-unit, both for one memory without a missing sample. The current bias "
            "may still be unknown",
            boolean=True,
        )
    )
    current_bias_valid: NDArray[np.bool_] = field(
        metadata=output(
            "",
            "The current bias is known too: `valid` is true, and the standard deviations of the "
            "bias are below a quarter of their priors",
            boolean=True,
        )
    )
    innovation: Array = field(
        metadata=output(
            "",
            "Residual of each relation before the update, divided by its assumed noise",
            in_files=False,
        )
    )


class ImmersionState(NamedTuple):
    """State of the observer: information ``R x = z``, information from noise, last samples."""

    R: Array
    z: Array
    noise: Array  # Information that would result from noise alone.
    currents: Array  # The last four currents, newest first.
    voltage: Array
    power: float = 1.0  # Mean square of the innovations.
    correlation: float = 0.0  # Correlation of successive innovations.
    last_innovation: Array | None = None
    last_normal: Array | None = None  # Last innovation divided by its expected size.
    samples: int = 0
    bad_voltages: int = 0
    bad_currents: int = 0
    missing: int = 0  # In a row.
    contradictions: int = 0  # In a row.
    known: int = 0  # Samples in a row with known flux.
    outliers: int = 0
    restarts: int = 0


@dataclass(frozen=True, eq=False)
class ImmersionObserver:
    """Exponentially forgetting least squares for flux, drift and current bias.

    Parameters
    ----------
    immersion : Immersion
        Relations and unknowns.
    R : (n, n) array_like
        Resistance in ``λ̇ = -R i + B u`` [Ω].
    B : (n, m) array_like
    sample_time : float
        Sample time [s], > 0.
    memory : float
        Exponential memory [s], at least ten samples.
    flux_base : (n,) array_like
        Magnitude of the flux [Wb]; a factor of a few does not matter.
    constraint_noise : (r,) array_like
        Std of each relation's residual, in the relation's unit.
    drift_prior : (n,) array_like
        Largest plausible drift [V].
    current_bias_prior : (n,) array_like
        Largest plausible current bias [A]; it is used if the bias is an unknown.
    current_noise : float, optional
        Noise std of a current component [A]; by default the value that causes `constraint_noise`.
        `noise_share`, and hence `valid`, depends on this std.
    voltage_noise : float
        Noise std of the mean voltage over a sample [V]; 0, the default, is for commanded voltages.

    Raises
    ------
    ObserverError
        A number is not positive, or the unknowns are not identifiable together.

    References
    ----------
    docs/theory.md, sections 4 to 6. G. J. Bierman, *Factorization Methods for Discrete Sequential
    Estimation*, Academic Press, 1977.
    """

    immersion: Immersion
    R: Array
    B: Array
    sample_time: float
    memory: float
    flux_base: Array
    constraint_noise: Array
    drift_prior: Array
    current_bias_prior: Array = field(default_factory=lambda: np.empty(0))
    current_noise: float | None = None
    voltage_noise: float = 0.0
    _prior: Array = field(init=False, repr=False)
    _volt_seconds_noise: Array = field(init=False, repr=False)
    _row_noise: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if not isinstance(self.immersion, Immersion):
            raise UsageError(f"immersion must be an Immersion, got {self.immersion!r}")
        n, r = self.immersion.n, len(self.immersion.relations)
        invisible = self.immersion.invisible()
        if invisible.shape[1]:
            raise ObserverError(
                f"{' and '.join(self.immersion.unknowns)} cannot be estimated together: "
                f"{describe_invisible(invisible)}"
            )
        shapes = {"flux_base": n, "constraint_noise": r, "drift_prior": n}
        if "current-bias" in self.immersion.unknowns:
            shapes["current_bias_prior"] = n
        for name, length in shapes.items():
            object.__setattr__(self, name, positive_vector(name, getattr(self, name), length))
        for name, columns in (("R", n), ("B", None)):
            matrix = finite_matrix(name, getattr(self, name), (n, columns))
            object.__setattr__(self, name, matrix)
        require_positive("sample_time", self.sample_time)
        require_memory(self.memory, self.sample_time)
        if self.immersion.R is not None and not np.array_equal(self.immersion.R, self.R):
            raise ObserverError("R differs from R of the immersion")
        if self.current_noise is None:
            object.__setattr__(self, "current_noise", self._default_current_noise())
        for name in ("current_noise", "voltage_noise"):
            require_not_negative(name, getattr(self, name))
        object.__setattr__(self, "_prior", self._prior_std())
        self._prepare_noise()

    def _default_current_noise(self) -> float:
        """Return the current noise that causes `constraint_noise` [A]."""
        slopes = [
            np.linalg.norm(self.flux_base @ relation.Q2) for relation in self.immersion.relations
        ]
        noises = zip(self.constraint_noise, slopes, strict=True)
        return float(min((noise / slope for noise, slope in noises if slope > 0), default=0.0))

    def _prepare_noise(self) -> None:
        """Prepare the noise of the volt-seconds, and the information that current noise adds."""
        noise = self.current_noise
        assert noise is not None  # __post_init__ has chosen it
        h, gain = self.sample_time, self.immersion.transition_gain()
        noise_gain = h * np.hstack([self.voltage_noise * self.B, noise * self.R])
        # Derivative of F⁻¹ along each direction of the noise of v.
        object.__setattr__(self, "_volt_seconds_noise", np.tensordot(noise_gain.T, gain, axes=1))
        # Information that the current noise in the rows of each sample adds.
        by_current = noise * self.immersion.row_gain() / self.constraint_noise[:, None, None]
        flattened = by_current.transpose(1, 0, 2).reshape(self.immersion.size, -1)
        object.__setattr__(self, "_row_noise", flattened @ flattened.T)

    def _prior_std(self) -> Array:
        """Return the prior standard deviation of each state."""
        flux, drift, unknowns = self.flux_base, self.drift_prior, self.immersion.unknowns
        bias = self.current_bias_prior if "current-bias" in unknowns else np.zeros_like(flux)
        if unknowns == ("current-bias",):
            drift = np.abs(self.R) @ bias
        prior_std = np.ones(self.immersion.size)
        slices = self.immersion.slices
        for k, relation in enumerate(self.immersion.relations):
            Q1, Q2, E = np.abs(relation.Q1), np.abs(relation.Q2), np.abs(relation.E)
            size = max(
                np.max(flux[:, None] * Q1 * flux),
                np.max(E * flux),
                np.max(flux[:, None] * Q2 * bias),
                abs(relation.d),
            )
            slope = np.maximum(2 * Q1 * flux, Q2 * bias).max(axis=1)
            # Fix a state that is zero by definition (for example with Q1 = 0).
            rate = float(np.max(drift / flux))
            smallest = 1e-9 * rate * max(size, self.constraint_noise[k])
            prior_std[slices["s"]][k] = max(size, self.constraint_noise[k])
            prior_std[slices["kappa"]][k] = max(np.max(drift * np.maximum(slope, E)), smallest)
            prior_std[slices["c"]][k] = max(np.max(drift[:, None] * Q1 * drift), rate * smallest)
        prior_std[slices["flux"]] = flux
        if "drift" in unknowns:
            prior_std[slices["drift"]] = drift
        if "current-bias" in unknowns:
            prior_std[slices["current_bias"]] = bias
        return prior_std

    def init(self, batch: tuple[int, ...] = ()) -> ImmersionState:
        """Return the initial state without information; one record at a time."""
        if batch:
            raise ObserverError("this observer takes one record at a time")
        size = self.immersion.size
        return ImmersionState(
            np.diag(1 / self._prior),
            np.zeros(size),
            np.zeros((size, size)),
            np.zeros((4, self.immersion.n)),
            np.zeros(0),
        )

    def step(
        self,
        state: ImmersionState,
        voltage: ArrayLike | None = None,
        current: ArrayLike | None = None,
        *,
        volt_seconds: ArrayLike | None = None,
    ) -> tuple[ImmersionState, ImmersionEstimate]:
        """Process one sample, like :meth:`LeastSquaresObserver.step`; shapes ``(m,)``, ``(n,)``.

        The last value replaces a missing (NaN) current or voltage, and a current that contradicts
        all earlier samples. No row is then valid for one memory. Four such samples in a row
        erase the information.
        """
        if current is None or (voltage is None) == (volt_seconds is None):
            raise UsageError("give current, and either voltage or volt_seconds")
        i = np.asarray(current, float)
        u = state.voltage if voltage is None else np.asarray(voltage, float)
        v = None if volt_seconds is None else np.asarray(volt_seconds, float)
        n, m = self.B.shape
        source, length = (u, m) if v is None else (v, n)
        if i.shape != (n,) or source.shape != (length,):
            raise RecordError(
                f"{'voltage' if v is None else 'volt_seconds'} must have shape ({length},) and "
                f"current ({n},), got {source.shape} and {i.shape}"
            )
        if v is not None and not np.isfinite(v).all():
            raise RecordError(
                "volt_seconds must be finite; for a missing sample, give NaN as current"
            )
        has_current = bool(np.isfinite(i).all())
        # The first voltage acts before the record: it may be missing.
        no_voltage = not np.isfinite(u).all() and state.samples > 0
        is_bad = not has_current or no_voltage
        held_current = state.currents[0] if state.samples else np.zeros(self.immersion.n)
        if not np.isfinite(u).all():
            u = state.voltage
        if u.size == 0:
            u = np.zeros(self.B.shape[1])
        missing = state.missing + 1 if is_bad else 0
        new_state = self._propagate(state, i if has_current else held_current, u, v)
        if has_current:
            measured = self._update_measurement(new_state, i)
            if measured is None:  # the current contradicts all earlier samples: treat it as missing
                new_state = self._propagate(state, held_current, u, v)
                new_state = new_state._replace(
                    contradictions=state.contradictions + 1,
                    outliers=state.outliers + 1,
                    known=0,
                )
            else:
                new_state = measured
        if missing >= MISSING:
            new_state = self._erase(new_state)
        new_state = new_state._replace(
            voltage=u,
            samples=state.samples + 1,
            bad_voltages=state.bad_voltages + no_voltage,
            bad_currents=state.bad_currents + (not has_current),
            missing=missing,
            known=0 if is_bad else new_state.known,
        )
        return self._estimate(new_state)

    def counts(self, state: ImmersionState) -> SampleCounts:
        """Return the numbers of bad samples, outliers and restarts in `state`."""
        return SampleCounts(
            state.bad_voltages, state.bad_currents, 0, state.outliers, state.restarts
        )

    def _propagate(
        self, state: ImmersionState, current: Array, voltage: Array, v: Array | None
    ) -> ImmersionState:
        """Propagate the state to a sample with this current."""
        h, immersion = self.sample_time, self.immersion
        if state.samples == 0:
            # Assume the same current before the first sample.
            return state._replace(currents=np.tile(current, (4, 1)))
        currents = np.vstack([current, state.currents[:-1]])
        if v is None:
            v = h * (self.B @ voltage - self.R @ (QUADRATURE @ currents))
        rho = 1 - h / self.memory
        inverse_transition = immersion.transition(-h, -v)
        R = state.R @ inverse_transition
        z = np.sqrt(rho) * (state.z + R @ immersion.known_input(v))
        R = np.sqrt(rho) * R
        noise = (
            rho * inverse_transition.T @ state.noise @ inverse_transition
            + self._noise_information(R)
        )
        return state._replace(R=R, z=z, noise=noise, currents=currents)

    def _erase(self, state: ImmersionState) -> ImmersionState:
        """Return the state without its information."""
        fresh = self.init()
        return state._replace(R=fresh.R, z=fresh.z, noise=fresh.noise, contradictions=0)

    def _update_measurement(self, state: ImmersionState, current: Array) -> ImmersionState | None:
        """Update with the relations at this current, and re-inject one row of the prior.

        Return None if the current contradicts all earlier samples, but a restart is not yet due.
        """
        immersion, sigma = self.immersion, self.constraint_noise
        rows, values = immersion.output_rows(current)
        rows, values = rows / sigma[:, None], values / sigma
        inverse = np.linalg.inv(state.R)
        innovation = values - rows @ (inverse @ state.z)
        expected_power = 1 + np.square(rows @ inverse).sum(axis=1)
        limit = CONTRADICTION**2 * expected_power * max(state.power, 1.0)
        rho = 1 - self.sample_time / self.memory
        if (innovation**2 > limit).any():
            if state.contradictions + 1 < CONTRADICTIONS:
                return None
            state = self._erase(state)._replace(
                # Currents that replaced missing currents were not measured.
                currents=np.tile(current, (4, 1)),
                restarts=state.restarts + 1,
                power=RESTART_POWER * max(state.power, 1.0),
            )
        else:
            # Prior and restarts explain large innovations: divide innovations by the expected size.
            normal = innovation / np.sqrt(expected_power)
            last_normal = state.last_normal
            product = 0.0 if last_normal is None else float(np.mean(normal * last_normal))
            state = state._replace(
                power=rho * state.power + (1 - rho) * float(np.mean(normal**2)),
                correlation=rho * state.correlation + (1 - rho) * product,
                last_normal=normal,
            )
        state = state._replace(last_innovation=innovation)
        R, z = _absorb(state.R, state.z, rows, values)
        # To prevent wind-up, re-inject row by row the prior's information that forgetting has
        # removed. Each row is centred on the estimate, so that the estimate does not move.
        if state.samples % REINJECTION_INTERVAL == 0:
            j = state.samples // REINJECTION_INTERVAL % immersion.size
            weight = np.sqrt(1 - rho ** (REINJECTION_INTERVAL * immersion.size)) / self._prior[j]
            row = np.zeros((1, immersion.size))
            row[0, j] = weight
            R, z = _absorb(R, z, row, weight * np.linalg.solve(R, z)[[j]])
        return state._replace(R=R, z=z, noise=state.noise + self._row_noise, contradictions=0)

    def _noise_information(self, R: Array) -> Array:
        """Return the information that noise of the last volt-seconds added to all past rows."""
        moved = R @ self._volt_seconds_noise
        stacked = moved.reshape(-1, len(R))
        return np.asarray(stacked.T @ stacked)

    def _estimate(self, state: ImmersionState) -> tuple[ImmersionState, ImmersionEstimate]:
        immersion, slices = self.immersion, self.immersion.slices
        inverse = np.linalg.inv(state.R)
        x = inverse @ state.z
        covariance = inverse @ inverse.T
        # Innovations of real records are correlated: scale the variance by power and correlation.
        r1 = float(np.clip(state.correlation / max(state.power, 1e-300), 0.0, CORRELATION_LIMIT))
        level = state.power * (1 + r1) / (1 - r1)
        # Small innovations must not reduce the share of the variance that comes from the prior.
        prior_variance = np.square(covariance / self._prior).sum(axis=1)
        variance = level * np.diag(covariance) + max(1 - level, 0.0) * prior_variance
        std = np.sqrt(variance)
        # Share of noise in the marginal information on each state.
        noise_information = (covariance * (state.noise @ covariance)).sum(axis=0)
        shares = noise_information / np.diag(covariance)
        flux_share = shares[slices["flux"]]
        n = immersion.n
        flux, flux_std = x[slices["flux"]], std[slices["flux"]]
        bias = x[slices["current_bias"]] if "current-bias" in immersion.unknowns else np.zeros(n)
        bias_std = (
            std[slices["current_bias"]] if "current-bias" in immersion.unknowns else np.zeros(n)
        )
        if "drift" in immersion.unknowns:
            drift, drift_std = x[slices["drift"]], std[slices["drift"]]
        else:
            drift, drift_std = self.R @ bias, np.sqrt(np.square(self.R) @ np.square(bias_std))
        # Compare each port with its own flux base: ports may differ in size.
        length = np.linalg.norm(flux / self.flux_base) / np.sqrt(n)
        known = bool(
            (flux_share < NOISE_SHARE_LIMIT).all()
            and (flux_std < KNOWN * length * self.flux_base).all()
            and state.contradictions == 0
            # A current bias that results from noise makes the flux wrong.
            and (shares[slices["current_bias"]] < NOISE_SHARE_LIMIT).all()
            and (
                np.abs(x[slices["current_bias"]]) < BIAS_LIMIT * self._prior[slices["current_bias"]]
            ).all()
            and np.isfinite(x).all()
        )
        state = state._replace(known=state.known + 1 if known and state.missing == 0 else 0)
        innovation = state.last_innovation
        valid = state.known * self.sample_time >= self.memory
        bias_identified = "current-bias" in immersion.unknowns and bool(
            (bias_std < UNSEEN_BIAS * self.current_bias_prior).all()
        )
        return state, ImmersionEstimate(
            flux,
            flux_std,
            drift,
            drift_std,
            bias,
            bias_std,
            flux_share,
            np.asarray(valid),
            np.asarray(valid and bias_identified),
            np.zeros(len(immersion.relations)) if innovation is None else innovation,
        )

    def run(
        self,
        voltage: Record | ArrayLike | None = None,
        current: ArrayLike | None = None,
        *,
        volt_seconds: ArrayLike | None = None,
    ) -> ImmersionEstimate:
        """Process a whole record from the initial state; the numbers are those of a loop of steps.

        Give a :class:`Record`, or arrays of shape ``(rows, m)`` and ``(rows, n)``. The voltage (or
        volt-seconds) of row k belongs to the interval that ends at row k.
        """
        if isinstance(voltage, Record):
            voltage, current = voltage.on_intervals(self.sample_time)
        return self.resume(self.init(), voltage, current, volt_seconds=volt_seconds)[1]

    def resume(
        self,
        state: ImmersionState,
        voltage: ArrayLike | None = None,
        current: ArrayLike | None = None,
        *,
        volt_seconds: ArrayLike | None = None,
    ) -> tuple[ImmersionState, ImmersionEstimate]:
        """Process a record from `state`; return the state after the last row and the estimates."""
        if current is None or (voltage is None) == (volt_seconds is None):
            raise UsageError("give current, and either voltage or volt_seconds")
        key = "voltage" if volt_seconds is None else "volt_seconds"
        source = np.asarray(voltage if volt_seconds is None else volt_seconds, float)
        currents = np.asarray(current, float)
        if currents.ndim != 2 or source.shape[:1] != currents.shape[:1] or source.ndim != 2:
            raise RecordError(
                f"voltage and current must have the same number of rows, got {source.shape} and "
                f"{currents.shape}"
            )
        estimates = []
        for sample, i in zip(source, currents, strict=True):
            state, estimate = self.step(state, current=i, **{key: sample})
            estimates.append(estimate)
        if not estimates:
            raise RecordError("the record has no rows")
        names = [output.name for output in fields(ImmersionEstimate)]
        return state, ImmersionEstimate(
            **{
                name: np.array([getattr(estimate, name) for estimate in estimates])
                for name in names
            }
        )


def _absorb(R: Array, z: Array, rows: Array, values: Array) -> tuple[Array, Array]:
    """Return the information factor after an update with weighted rows."""
    n = len(R)
    stacked = np.empty((n + len(rows), n + 1))
    stacked[:n, :n], stacked[:n, n] = R, z
    stacked[n:, :n], stacked[n:, n] = rows, values
    # LAPACK may return rows with the opposite sign, which has no meaning.
    factor: Any = np.linalg.qr(stacked, mode="r")
    return factor[:n, :n], factor[:n, n]


def describe_invisible(directions: NDArray[np.floating]) -> str:
    """Describe the offsets of flux and current that no record can reveal."""
    n = len(directions) // 2
    clauses = []
    for column in directions.T:
        column = column / np.abs(column[n:]).max() if np.abs(column[n:]).max() > 0 else column
        flux = ", ".join(f"{value:.3g}" for value in column[:n] + 0.0)
        current = ", ".join(f"{value:.3g}" for value in column[n:] + 0.0)
        clauses.append(f"an offset of ({flux}) Wb in the flux with ({current}) A in the current")
    return " and ".join(clauses) + " changes no relation"
