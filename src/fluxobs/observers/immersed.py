"""Readable least squares on the immersion: any number of ports and relations, current bias too.

The recursion is that of firmware/fluxobs.c, the special case of one relation, two ports and unknown
drift. This one is written to be read, and judges validity more simply.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..core.arrays import Array
from ..errors import ObserverError, RecordError, UsageError
from ..logs.record import Record
from ..machines.model.immersion import Immersion
from .base import SampleCounts
from .outputs import documented, output

#: Share of the flux information that may come from noise, as in the compiled observer.
NOISE_SHARE_LIMIT: float = _core.thresholds["SHARE_LIMIT"]
#: Cap on the correlation of successive innovations, as in the compiled observer.
CORRELATION_LIMIT: float = _core.thresholds["CORRELATION_LIMIT"]
#: This many missing samples in a row erase all that is known, as in the compiled observer.
MISSING: int = int(_core.thresholds["MAX_CONSECUTIVE_BAD"]) + 1
#: A flux is known if its standard deviation is below this share of the flux, per-unit. For the flux
#: of a rotor this is 3° of its angle, the compiled observer's limit (STD_LIMIT).
KNOWN = 0.05
#: A sample whose innovation exceeds this many standard deviations contradicts all earlier samples.
#: Noise does not reach ten; a jump of an offset does within a few samples (tests/observers).
CONTRADICTION = 10.0
#: This many contradictions in a row mean that a constant has jumped: restart. Fewer could be a
#: burst of spikes, which the compiled observer also bridges.
CONTRADICTIONS = MISSING
#: A restart multiplies the innovations' power by this, so that noise above the assumed one cannot
#: restart for ever: four restarts make up for an assumed noise 16 times too small.
RESTART_POWER = 4.0
#: A current bias beyond this many standard deviations of its prior is an artefact of noise. It
#: corrupts the flux, which is then not valid.
BIAS_LIMIT = 3.0
#: Nothing was learnt about a current bias whose standard deviation stays above this share of its
#: prior. Without data it is the prior's; where two ports hide one direction, 0.7 of it each.
UNSEEN_BIAS = 0.25
#: Samples between two re-injected rows of the prior, which take turns as in the compiled observer.
EVERY = 2
#: Mean current of the last interval from the last four samples, newest first: the cubic through
#: them.
QUADRATURE = np.array([9.0, 19.0, -5.0, 1.0]) / 24


@documented
@dataclass(frozen=True, eq=False)
class ImmersionEstimate:
    """What the least squares returns for one sample (leading shape ``()``) or a record ``(rows,)``.

    With n ports and r relations vectors are (..., n), and the innovation is (..., r).
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
        metadata=output(
            "", "Share of each flux component's information that is only noise", vector=True
        )
    )
    valid: NDArray[np.bool_] = field(
        metadata=output(
            "",
            "The flux is known: noise share below 0.1 and standard deviation below a twentieth of "
            "the flux, per-unit, both for one memory without a missing sample. Says nothing of the "
            "current bias",
            boolean=True,
        )
    )
    current_bias_valid: NDArray[np.bool_] = field(
        metadata=output(
            "",
            "The current bias is known too: valid, and every standard deviation below a "
            "quarter of its prior",
            boolean=True,
        )
    )
    innovation: Array = field(
        metadata=output(
            "",
            "Residual of each relation over its assumed noise, before the update",
            in_files=False,
        )
    )


class ImmersionState(NamedTuple):
    """All that is remembered: information ``R x = z``, its part from noise, and a few samples."""

    R: Array
    z: Array
    noise: Array  # information that noise alone would have produced
    currents: Array  # the last four, newest first
    voltage: Array
    power: float = 1.0  # of the innovations
    correlation: float = 0.0  # of successive ones
    last_innovation: Array | None = None
    last_normal: Array | None = None  # over its expected size
    samples: int = 0
    bad_voltages: int = 0
    bad_currents: int = 0
    missing: int = 0  # in a row
    contradictions: int = 0  # in a row
    known: int = 0  # samples in a row
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
        [s], > 0.
    memory : float
        [s], at least ten samples.
    flux_base : (n,) array_like
        Size of the flux [Wb], within a factor of a few.
    constraint_noise : (r,) array_like
        Std of each relation's residual, in its own unit.
    drift_prior : (n,) array_like
        Largest plausible drift [V].
    current_bias_prior : (n,) array_like
        Largest plausible current bias [A]; used if it is an unknown.
    current_noise : float, optional
        Std of a current component [A]; default: the one that causes `constraint_noise`.
        `noise_share`, and so `valid`, depends on it.
    voltage_noise : float
        Std of the mean voltage over a sample [V]; default 0, for a command.

    Raises
    ------
    ObserverError
        A number is not positive, or these relations cannot tell an unknown from others.

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
                f"{' and '.join(self.immersion.unknowns)} cannot be found together: "
                f"{describe_invisible(invisible)}"
            )
        shapes = {"flux_base": n, "constraint_noise": r, "drift_prior": n}
        if "current-bias" in self.immersion.unknowns:
            shapes["current_bias_prior"] = n
        for name, length in shapes.items():
            value = np.array(np.broadcast_to(getattr(self, name), (length,)), dtype=float)
            if not (np.isfinite(value) & (value > 0)).all():
                raise ObserverError(f"{name} must be positive and finite, got {value}")
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        for name in ("R", "B"):
            matrix = np.array(getattr(self, name), dtype=float)
            if matrix.ndim != 2 or len(matrix) != n or (name == "R" and matrix.shape != (n, n)):
                raise ObserverError(f"{name} must have {n} rows, got shape {matrix.shape}")
            if not np.isfinite(matrix).all():
                raise ObserverError(f"{name} must be finite, got {matrix.tolist()}")
            object.__setattr__(self, name, matrix)
        if not (np.isfinite(self.sample_time) and self.sample_time > 0):
            raise ObserverError(f"sample_time must be positive and finite, got {self.sample_time}")
        if not self.memory >= 10 * self.sample_time:
            raise ObserverError(
                f"memory must be at least ten samples, {10 * self.sample_time:g} s here, "
                f"got {self.memory:g} s"
            )
        if self.immersion.R is not None and not np.array_equal(self.immersion.R, self.R):
            raise ObserverError("R differs from that of the immersion")
        noise = self.current_noise
        if noise is None:
            slopes = [
                np.linalg.norm(self.flux_base @ relation.Q2)
                for relation in self.immersion.relations
            ]
            shares = [s / k for s, k in zip(self.constraint_noise, slopes, strict=True) if k > 0]
            noise = float(min(shares, default=0.0))
            object.__setattr__(self, "current_noise", noise)
        for name in ("current_noise", "voltage_noise"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) >= 0):
                raise ObserverError(f"{name} must be a number >= 0, got {getattr(self, name)}")
        object.__setattr__(self, "_prior", self._prior_std())
        h, gain = self.sample_time, self.immersion.transition_gain()
        pushes = h * np.hstack([self.voltage_noise * self.B, noise * self.R])
        # For each direction of v's noise, ∂F⁻¹ along it.
        object.__setattr__(self, "_volt_seconds_noise", np.tensordot(pushes.T, gain, axes=1))
        # Information that the noise of a current adds with the rows of every sample.
        by_current = noise * self.immersion.row_gain() / self.constraint_noise[:, None, None]
        flat = by_current.transpose(1, 0, 2).reshape(self.immersion.size, -1)
        object.__setattr__(self, "_row_noise", flat @ flat.T)

    def _prior_std(self) -> Array:
        """Prior standard deviation of every state."""
        flux, drift, unknowns = self.flux_base, self.drift_prior, self.immersion.unknowns
        bias = self.current_bias_prior if "current-bias" in unknowns else np.zeros_like(flux)
        if unknowns == ("current-bias",):
            drift = np.abs(self.R) @ bias
        out = np.ones(self.immersion.size)
        at = self.immersion.slices
        for k, relation in enumerate(self.immersion.relations):
            Q1, Q2, E = np.abs(relation.Q1), np.abs(relation.Q2), np.abs(relation.E)
            size = max(
                np.max(flux[:, None] * Q1 * flux),
                np.max(E * flux),
                np.max(flux[:, None] * Q2 * bias),
                abs(relation.d),
            )
            slope = np.maximum(2 * Q1 * flux, Q2 * bias).max(axis=1)
            # A state that is zero by definition (Q1 = 0, say) is pinned, not left free.
            rate = float(np.max(drift / flux))
            least = 1e-9 * rate * max(size, self.constraint_noise[k])
            out[at["s"]][k] = max(size, self.constraint_noise[k])
            out[at["kappa"]][k] = max(np.max(drift * np.maximum(slope, E)), least)
            out[at["c"]][k] = max(np.max(drift[:, None] * Q1 * drift), rate * least)
        out[at["flux"]] = flux
        if "drift" in unknowns:
            out[at["drift"]] = drift
        if "current-bias" in unknowns:
            out[at["current_bias"]] = bias
        return out

    def init(self, batch: tuple[int, ...] = ()) -> ImmersionState:
        """Initial state, in which nothing is known; one record at a time."""
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
        """Process one sample; as :meth:`LeastSquaresObserver.step`, with ``(m,)`` and ``(n,)``.

        For a missing (NaN) current or voltage the last value is held, and also for a current that
        contradicts all earlier samples; nothing is valid for one memory after that. Four in a row
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
            raise RecordError("volt_seconds must be finite; mark a missing sample by current NaN")
        known = bool(np.isfinite(i).all())
        # The first voltage belongs to an interval before the record: it may be missing.
        no_voltage = not np.isfinite(u).all() and state.samples > 0
        bad = not known or no_voltage
        held = state.currents[0] if state.samples else np.zeros(self.immersion.n)
        if not np.isfinite(u).all():
            u = state.voltage
        if u.size == 0:
            u = np.zeros(self.B.shape[1])
        missing = state.missing + 1 if bad else 0
        after = self._move(state, i if known else held, u, v)
        if known:
            measured = self._measure(after, i)
            if measured is None:  # contradicts all before: treat it as missing
                after = self._move(state, held, u, v)
                after = after._replace(
                    contradictions=state.contradictions + 1,
                    outliers=state.outliers + 1,
                    known=0,
                )
            else:
                after = measured
        if missing >= MISSING:
            after = self._emptied(after)
        after = after._replace(
            voltage=u,
            samples=state.samples + 1,
            bad_voltages=state.bad_voltages + no_voltage,
            bad_currents=state.bad_currents + (not known),
            missing=missing,
            known=0 if bad else after.known,
        )
        return self._read_out(after)

    def counts(self, state: ImmersionState) -> SampleCounts:
        """Bad samples, outliers and restarts that `state` has seen."""
        return SampleCounts(
            state.bad_voltages, state.bad_currents, 0, state.outliers, state.restarts
        )

    def _move(
        self, state: ImmersionState, current: Array, voltage: Array, v: Array | None
    ) -> ImmersionState:
        """Time update to a sample with this current."""
        h, immersion = self.sample_time, self.immersion
        if state.samples == 0:
            # Assume that the current was the same before the first sample.
            return state._replace(currents=np.tile(current, (4, 1)))
        currents = np.vstack([current, state.currents[:-1]])
        if v is None:
            v = h * (self.B @ voltage - self.R @ (QUADRATURE @ currents))
        rho = 1 - h / self.memory
        back = immersion.transition(-h, -v)
        R = state.R @ back
        z = np.sqrt(rho) * (state.z + R @ immersion.known_input(v))
        R = np.sqrt(rho) * R
        noise = rho * back.T @ state.noise @ back + self._pretended(R)
        return state._replace(R=R, z=z, noise=noise, currents=currents)

    def _emptied(self, state: ImmersionState) -> ImmersionState:
        """The same state without its information."""
        fresh = self.init()
        return state._replace(R=fresh.R, z=fresh.z, noise=fresh.noise, contradictions=0)

    def _measure(self, state: ImmersionState, current: Array) -> ImmersionState | None:
        """Take in the relations at this current, and re-inject one row of the prior.

        Returns None if the current contradicts all before, but not often enough for a restart.
        """
        immersion, sigma = self.immersion, self.constraint_noise
        rows, values = immersion.output_rows(current)
        rows, values = rows / sigma[:, None], values / sigma
        inverse = np.linalg.inv(state.R)
        innovation = values - rows @ (inverse @ state.z)
        expected = 1 + np.square(rows @ inverse).sum(axis=1)
        limit = CONTRADICTION**2 * expected * max(state.power, 1.0)
        rho = 1 - self.sample_time / self.memory
        if (innovation**2 > limit).any():
            if state.contradictions + 1 < CONTRADICTIONS:
                return None
            state = self._emptied(state)._replace(
                # The currents held meanwhile were not measured.
                currents=np.tile(current, (4, 1)),
                restarts=state.restarts + 1,
                power=RESTART_POWER * max(state.power, 1.0),
            )
        else:
            # What the prior or a restart explains is not noise: judge by the expected size.
            normal = innovation / np.sqrt(expected)
            last = state.last_normal
            product = 0.0 if last is None else float(np.mean(normal * last))
            state = state._replace(
                power=rho * state.power + (1 - rho) * float(np.mean(normal**2)),
                correlation=rho * state.correlation + (1 - rho) * product,
                last_normal=normal,
            )
        state = state._replace(last_innovation=innovation)
        R, z = _absorb(state.R, state.z, rows, values)
        # Against wind-up: re-inject, row by row, what forgetting takes from the prior. Centred on
        # the estimate, it does not move it.
        if state.samples % EVERY == 0:
            j = state.samples // EVERY % immersion.size
            weight = np.sqrt(1 - rho ** (EVERY * immersion.size)) / self._prior[j]
            row = np.zeros((1, immersion.size))
            row[0, j] = weight
            R, z = _absorb(R, z, row, weight * np.linalg.solve(R, z)[[j]])
        return state._replace(R=R, z=z, noise=state.noise + self._row_noise, contradictions=0)

    def _pretended(self, R: Array) -> Array:
        """Information that noise of the last volt-seconds has added to all past rows."""
        moved = R @ self._volt_seconds_noise
        stacked = moved.reshape(-1, len(R))
        return np.asarray(stacked.T @ stacked)

    def _read_out(self, state: ImmersionState) -> tuple[ImmersionState, ImmersionEstimate]:
        immersion, at = self.immersion, self.immersion.slices
        inverse = np.linalg.inv(state.R)
        x = inverse @ state.z
        covariance = inverse @ inverse.T
        # Innovations of real records are coloured: their power and correlation scale the variance.
        r1 = float(np.clip(state.correlation / max(state.power, 1e-300), 0.0, CORRELATION_LIMIT))
        level = state.power * (1 + r1) / (1 - r1)
        # What only the prior holds stays as uncertain as the prior, however small the innovations.
        held = np.square(covariance / self._prior).sum(axis=1)
        variance = level * np.diag(covariance) + max(1 - level, 0.0) * held
        std = np.sqrt(variance)
        # Share of each state's marginal information that comes from noise.
        spread = (covariance * (state.noise @ covariance)).sum(axis=0)
        all_shares = spread / np.diag(covariance)
        share = all_shares[at["flux"]]
        n = immersion.n
        flux, flux_std = x[at["flux"]], std[at["flux"]]
        bias = x[at["current_bias"]] if "current-bias" in immersion.unknowns else np.zeros(n)
        bias_std = std[at["current_bias"]] if "current-bias" in immersion.unknowns else np.zeros(n)
        if "drift" in immersion.unknowns:
            drift, drift_std = x[at["drift"]], std[at["drift"]]
        else:
            drift, drift_std = self.R @ bias, np.sqrt(np.square(self.R) @ np.square(bias_std))
        # Judge each port by its own size: a large one says nothing about a small one.
        length = np.linalg.norm(flux / self.flux_base) / np.sqrt(n)
        known = bool(
            (share < NOISE_SHARE_LIMIT).all()
            and (flux_std < KNOWN * length * self.flux_base).all()
            and state.contradictions == 0
            # A current bias that is an artefact of noise corrupts the flux.
            and (all_shares[at["current_bias"]] < NOISE_SHARE_LIMIT).all()
            and (np.abs(x[at["current_bias"]]) < BIAS_LIMIT * self._prior[at["current_bias"]]).all()
            and np.isfinite(x).all()
        )
        state = state._replace(known=state.known + 1 if known and state.missing == 0 else 0)
        innovation = state.last_innovation
        valid = state.known * self.sample_time >= self.memory
        seen = "current-bias" in immersion.unknowns and bool(
            (bias_std < UNSEEN_BIAS * self.current_bias_prior).all()
        )
        return state, ImmersionEstimate(
            flux,
            flux_std,
            drift,
            drift_std,
            bias,
            bias_std,
            share,
            np.asarray(valid),
            np.asarray(valid and seen),
            np.zeros(len(immersion.relations)) if innovation is None else innovation,
        )

    def run(
        self,
        voltage: Record | ArrayLike | None = None,
        current: ArrayLike | None = None,
        *,
        volt_seconds: ArrayLike | None = None,
    ) -> ImmersionEstimate:
        """Process a whole record from the initial state; the same numbers as the step loop.

        Takes a :class:`Record`, or ``(rows, m)`` and ``(rows, n)`` arrays: row k's voltage (or
        volt-seconds) belongs to the interval that ends at row k.
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
        """Like :meth:`run`, from `state`; returns the state after the last row too."""
        if current is None or (voltage is None) == (volt_seconds is None):
            raise UsageError("give current, and either voltage or volt_seconds")
        key = "voltage" if volt_seconds is None else "volt_seconds"
        source = np.asarray(voltage if volt_seconds is None else volt_seconds, float)
        currents = np.asarray(current, float)
        if currents.ndim != 2 or source.shape[:1] != currents.shape[:1] or source.ndim != 2:
            raise RecordError(
                f"voltage and current must have as many rows, got {source.shape} and "
                f"{currents.shape}"
            )
        found = []
        for given, i in zip(source, currents, strict=True):
            state, estimate = self.step(state, current=i, **{key: given})
            found.append(estimate)
        if not found:
            raise RecordError("the record has no rows")
        names = [one.name for one in fields(ImmersionEstimate)]
        return state, ImmersionEstimate(
            **{name: np.array([getattr(row, name) for row in found]) for name in names}
        )


def _absorb(R: Array, z: Array, rows: Array, values: Array) -> tuple[Array, Array]:
    """The triangle after taking in weighted rows."""
    n = len(R)
    stacked = np.empty((n + len(rows), n + 1))
    stacked[:n, :n], stacked[:n, n] = R, z
    stacked[n:, :n], stacked[n:, n] = rows, values
    # LAPACK's rows may come out negative; the sign of a row means nothing.
    triangle: Any = np.linalg.qr(stacked, mode="r")
    return triangle[:n, :n], triangle[:n, n]


def describe_invisible(directions: NDArray[np.floating]) -> str:
    """Describe in words the offsets of flux and current that no record can reveal."""
    n = len(directions) // 2
    out = []
    for column in directions.T:
        column = column / np.abs(column[n:]).max() if np.abs(column[n:]).max() > 0 else column
        flux = ", ".join(f"{value:.3g}" for value in column[:n] + 0.0)
        current = ", ".join(f"{value:.3g}" for value in column[n:] + 0.0)
        out.append(f"an offset of ({flux}) Wb in the flux with ({current}) A in the current")
    return " and ".join(out) + " leaves every relation as it is"
