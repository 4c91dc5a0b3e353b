"""The production least squares in JAX: readable, differentiable, batched, usable inside a loop.

The twin of firmware/fluxobs.c, function by function, in double precision; equal to it to rounding
over whole records. It exists so that a closed loop can be simulated with the observer in it, and
many at once. Left out is only what the C core does with numbers that have run away.
docs/theory.md, sections 4 to 6, says why each step is as it is.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ... import _core
from ...observers import Estimate, LeastSquaresObserver

#: The compiled observer's thresholds, with their reasons in firmware/fluxobs_internal.h.
C: SimpleNamespace = SimpleNamespace(**_core.thresholds)
STD_UNKNOWN = np.sqrt(C.VARIANCE_UNKNOWN)
SIZE = 7
#: Samples take turns: in one a prior row is re-injected, in the next the certainty is judged.
PERIOD = int(C.REINJECT_PERIOD)
#: Columns of the information triangle: s, flux, kappa, drift, c, and what they solve for.
S, FLUX, KAPPA, DRIFT, CC, Z = 0, slice(1, 3), 3, slice(4, 6), 6, 7
PRIOR_POWER = np.array([0, 0, 0, 1, 1, 1, 2])

Array = jax.Array


class TwinState(NamedTuple):
    """Everything that changes; per-unit (flux base, memory) unless said."""

    triangle: Array  # (7, 8): R | z of R x = z, x = (s, flux, kappa, drift, c)
    x: Array  # (7,) its solution
    noise: Array  # (3,) information that noise alone pretends: flux, flux-drift, drift
    currents: Array  # (4, 2) newest first [A]
    source: Array  # (2,) last good volt-seconds
    step: Array  # of the position vector, over the last interval
    length: Array  # |flux - L i|
    rough: Array  # variance of a current component by its roughness [A²]
    exposed: Array  # turn by a plausible voltage error, flux base [rad]
    innovation: Array
    power: Array
    lag_one: Array
    noise_share: Array  # as last judged
    inflation: Array
    spread: Array  # variance of the least squares' angle [rad²]
    prior_scale: Array  # the drift's prior has proved too tight by this
    theta: Array  # of the least squares [rad]
    swept: Array  # turned since it is known [rad]
    flux: Array  # (2,) last trusted
    drift: Array  # (2,) last trusted
    variance: Array  # of the carried position at its start [rad²]
    growth: Array
    carried: Array  # for how long
    carried_length: Array  # of the position vector when it began
    carried_off: Array  # largest square of its relative change since
    angle: Array  # tracker [rad], [rad/s], [rad/s²]
    speed: Array
    acceleration: Array
    settled: Array  # the tracker is near for so long
    lost: Array  # its speed is taken from the next angle
    have_current: Array
    have_voltage: Array
    trusted: Array
    have_carried: Array
    turn: Array
    consecutive_bad: Array
    restarts: Array
    outliers: Array


class Reading(NamedTuple):
    """What a sample says; fields as of :class:`fluxobs.observers.Estimate`."""

    flux: Array
    psi_f: Array
    theta_e: Array
    theta_e_tracked: Array
    speed_e: Array
    drift: Array
    theta_e_std: Array
    valid: Array
    innovation: Array
    noise_share: Array


class SquareRootLeastSquares(eqx.Module):
    """Square-root information least squares on the immersion, one sample at a time.

    Make it with :meth:`of`. Every field is an array: a batch of observers for a batch of machines
    is the same object with stacked leaves.

    Examples
    --------
    >>> from fluxobs import LeastSquaresObserver
    >>> from fluxobs.machines import example
    >>> compiled = LeastSquaresObserver.for_machine(example("servo-400w"), sample_time=1e-4)
    >>> observer = SquareRootLeastSquares.of(compiled)
    >>> state, reading = observer.step(observer.init(), jnp.zeros(2), jnp.array([0.1, 0.0]))
    >>> bool(reading.valid)
    False
    """

    Q1x2: Array  # (2, 2) 2 Q1, per-unit
    E: Array  # (2,) per-unit
    row_Q2: Array  # (2, 2) whitened [1/A]
    row_Q3: Array  # (2, 2) [1/A²]
    row_C: Array  # (2,) [1/A]
    row_s: Array
    hR: Array  # (2, 2) current times 24 to volt-seconds
    hB: Array  # (2, 2)
    h: Array  # sample time over memory
    prior: Array  # (7,) 1 / std
    reinject: Array  # (7,)
    noise_information: Array
    flux_base: Array
    drift_base: Array
    current_limit: Array
    over_noise: Array
    length_min: Array
    L_position: Array
    position_noise: Array
    sample_time: Array
    track: Array  # (3,)

    @classmethod
    def of(cls, observer: LeastSquaresObserver) -> Self:
        """The twin of a compiled observer (fo_init)."""
        c, psi = observer.constraint, observer.flux_base
        size = float(np.abs(c.Q1).max())
        base = size * psi**2 if size > 0 else observer.constraint_noise
        sigma, noise = observer.constraint_noise, observer.current_noise
        h, memory = observer.sample_time, observer.memory
        drift_base = psi / memory
        drift_prior = observer.drift_prior / drift_base
        prior = 1 / np.array([1, 1, 1, 2 * drift_prior, drift_prior, drift_prior, drift_prior**2])
        row_Q2 = c.Q2 * psi / sigma
        walk = (np.trace(observer.R) / 2) ** 2 * h * memory / 4
        x = observer.tracker_bandwidth * h
        pole = 1 / (1 + x + x * x / 2)
        gap = 1 - pole
        track = [1 - pole**3, 1.5 * gap**2 * (1 + pole) / h, gap**3 / h**2]
        values = {
            "Q1x2": 2 * c.Q1 * psi**2 / base,
            "E": c.E * psi / base,
            "row_Q2": row_Q2,
            "row_Q3": c.Q3 / sigma,
            "row_C": c.C / sigma,
            "row_s": base / sigma,
            "hR": h * observer.R / (24 * psi),
            "hB": h * observer.B / psi,
            "h": h / memory,
            "prior": prior,
            "reinject": np.sqrt(1 - (1 - h / memory) ** PERIOD) * prior,
            "noise_information": np.sum(row_Q2**2) / 2 * noise**2,
            "flux_base": psi,
            "drift_base": drift_base,
            "current_limit": observer.current_limit,
            "over_noise": 1 / noise**2,
            "length_min": observer.length_min / psi,
            "L_position": observer.position_inductance / psi,
            "position_noise": (observer.position_inductance**2 + walk) * noise**2 / psi**2,
            "sample_time": h,
            "track": track,
        }
        return cls(**{name: jnp.asarray(value, float) for name, value in values.items()})

    def init(self) -> TwinState:
        """Nothing known."""
        zero, pair, no = jnp.zeros(()), jnp.zeros(2), jnp.zeros((), bool)
        names = TwinState._fields
        blank: dict[str, Any] = dict.fromkeys(names, zero)
        blank |= dict.fromkeys(("source", "flux", "drift"), pair)
        flags = ("have_current", "have_voltage", "trusted", "have_carried", "lost")
        blank |= dict.fromkeys(flags, no)
        count = jnp.zeros((), jnp.int32)
        blank |= dict.fromkeys(("turn", "consecutive_bad", "restarts", "outliers"), count)
        blank |= {
            "triangle": jnp.zeros((SIZE, SIZE + 1)),
            "x": jnp.zeros(SIZE),
            "noise": jnp.zeros(3),
            "currents": jnp.zeros((4, 2)),
            "prior_scale": jnp.ones(()),
        }
        return self._restarted(TwinState(**blank))

    def step(self, state: TwinState, voltage: Array, current: Array) -> tuple[TwinState, Reading]:
        """One sample: mean voltage over the interval ending now [V], the current now [A]."""
        return self._advance(state, self.hB @ voltage, current, complete=False)

    def step_volt_seconds(
        self, state: TwinState, volt_seconds: Array, current: Array
    ) -> tuple[TwinState, Reading]:
        """The same with the interval's volt-seconds, ∫(-R i + B u) dt [Wb], known exactly."""
        return self._advance(state, volt_seconds / self.flux_base, current, complete=True)

    # ---- square-root information filter --------------------------------------------------

    @property
    def _rho(self) -> Array:
        return 1 - self.h

    def _empty(self, s: TwinState) -> TwinState:
        """Only the prior is left; the innovations start at their assumed level."""
        zero = jnp.zeros(())
        triangle = jnp.diag(self.prior / s.prior_scale**PRIOR_POWER)
        return s._replace(
            triangle=jnp.pad(triangle, ((0, 0), (0, 1))),
            x=jnp.zeros(SIZE),
            noise=jnp.zeros(3),
            innovation=zero,
            power=1 / self.h,
            lag_one=zero,
            noise_share=jnp.ones(()),
            swept=zero,
            trusted=jnp.zeros((), bool),
            turn=jnp.zeros((), jnp.int32),
        )

    def _restarted(self, s: TwinState) -> TwinState:
        no = jnp.zeros((), bool)
        return self._empty(s)._replace(
            have_current=no,
            have_voltage=no,
            variance=jnp.asarray(C.VARIANCE_UNKNOWN),
        )

    def _predict(self, s: TwinState, v: Array) -> TwinState:
        """R ← √ρ R F⁻¹, z ← √ρ (z + R F⁻¹ d): columns of F(h, v)⁻¹ = F(-h, -v)."""
        h, T = self.h, s.triangle
        q = self.Q1x2 @ v
        free, kappa = T[:, S], T[:, KAPPA]
        flux = T[:, FLUX] - free[:, None] * q
        kappa_new = kappa - h * free
        drift = T[:, DRIFT] - h * T[:, FLUX] - kappa_new[:, None] * q
        c = T[:, CC] - h * (kappa + kappa_new)
        z = T[:, Z] + free * (q @ v / 2 + self.E @ v) + flux @ v
        columns = [free[:, None], flux, kappa_new[:, None], drift, c[:, None], z[:, None]]
        n0, n1, n2 = s.noise
        noise = [n0, n1 - h * n0, n2 - 2 * h * n1 + h * h * n0]
        return s._replace(
            triangle=jnp.sqrt(self._rho) * jnp.concatenate(columns, axis=1),
            noise=self._rho * jnp.stack(noise),
        )

    def _roughness(self, s: TwinState) -> Array:
        return jnp.maximum(s.rough * self.over_noise, 1.0)

    def _relation(self, current: Array) -> Array:
        """Row and right-hand side of 0 = s + (Q2 i)ᵀflux + iᵀQ3 i + Cᵀi, divided by its noise."""
        rhs = -(self.row_C @ current + current @ self.row_Q3 @ current)
        row = [self.row_s[None], self.row_Q2 @ current, jnp.zeros(4), rhs[None]]
        return jnp.concatenate(row)

    def _contradicts(self, s: TwinState, v: Array, row: Array) -> Array:
        """Is the measurement far from what the estimate before the interval leads to?"""
        h, x, q = self.h, s.x, self.Q1x2 @ v
        flux = x[FLUX] + h * x[DRIFT]
        free = x[S] + q @ v / 2 + self.E @ v + h * (x[KAPPA] + h * x[CC]) + q @ flux
        off = row[Z] - row[S] * free - row[FLUX] @ (flux + v)
        contradicts: Array = ~(jnp.abs(off) < C.OUTLIER_LIMIT * self.row_s)
        return contradicts

    def _measure(self, s: TwinState, row: Array) -> TwinState:
        triangle, e = absorb(s.triangle, row)
        c = s.currents
        third = c[0] - c[3] + 3 * (c[2] - c[1])
        return s._replace(
            triangle=triangle,
            power=self._rho * s.power + e * e,
            lag_one=self._rho * s.lag_one + e * s.innovation,
            innovation=e,
            noise=s.noise + self.noise_information * self._roughness(s) * np.array([1.0, 0, 0]),
            rough=s.rough + self.h * (third @ third / 40 - s.rough),
        )

    # ---- read-out ------------------------------------------------------------------------

    def _read_out(self, s: TwinState, v: Array) -> tuple[TwinState, Reading]:
        """The least squares' own flux while it is trusted, else the last trusted carried on."""
        inverse = invert(s.triangle[:, :SIZE])
        x = inverse @ s.triangle[:, Z]
        current = s.currents[0]
        p = x[FLUX] - self.L_position * current
        flux, drift = x[FLUX], x[DRIFT]
        square = p @ p
        theta = jnp.arctan2(p[1], p[0])
        long_enough = square > self.length_min**2
        s = self._taken_turn(s._replace(x=x), inverse, p, square, long_enough)
        known = long_enough & (s.noise_share < C.SHARE_LIMIT)
        swept = jnp.where(known, s.swept + wrap(theta - s.theta), 0.0)
        trusted = known & (s.trusted | (jnp.abs(swept) > C.SWEEP))

        # Trusted: the covariance across p, and the noise of the current in it.
        floor = self.position_noise * self._roughness(s)
        own_variance = s.spread + floor / square
        # Not trusted: the last trusted flux goes on by integration.
        start = s.flux - self.L_position * current
        begins = s.carried == 0
        plausible = 1 / self.prior[4]
        start_square = start @ start
        across = (start[1] * inverse[4] - start[0] * inverse[5]) ** 2
        grows = (s.inflation * jnp.sum(across) / start_square + plausible**2) / start_square
        growth = jnp.where(begins, grows, s.growth)
        carried_length = jnp.where(begins, jnp.sqrt(start_square), s.carried_length)
        carried = s.carried + self.h
        carried_flux = s.flux + v + self.h * s.drift
        # What is wrong with the drift shows in the length, which should stay.
        now = carried_flux - self.L_position * current
        off = jnp.sqrt(now @ now) / jnp.where(carried_length > 0, carried_length, 1.0) - 1
        off = jnp.maximum(off**2, jnp.where(begins, 0.0, s.carried_off))
        carried_variance = s.variance + growth * carried**2 + off
        lost = ~(carried_variance < C.VARIANCE_UNKNOWN)
        carried_flux = jnp.where(lost, s.flux, carried_flux)
        carries = ~trusted & s.have_carried
        variance = jnp.where(
            trusted,
            own_variance,
            jnp.where(carries & ~lost, carried_variance, C.VARIANCE_UNKNOWN),
        )
        shows_carried = carries & (~known | ~lost)
        out_flux = jnp.where(shows_carried, carried_flux, flux)
        out_drift = jnp.where(shows_carried, s.drift, drift)
        p = out_flux - self.L_position * current
        square = p @ p
        length = jnp.sqrt(square)
        out_theta = jnp.arctan2(p[1], p[0])
        unknown = ~(variance < C.VARIANCE_UNKNOWN)
        tracker = self._track(s, out_theta, unknown & ~known)
        std = jnp.where(unknown, STD_UNKNOWN, jnp.sqrt(variance))
        near = jnp.abs(wrap(out_theta - tracker[0])) < C.STD_LIMIT + 3 * std
        counts = jnp.where(near, self.h, C.TRACKER_OFF * self.h)
        settled = jnp.where(tracker[3] < C.TRACKER_SETTLED, tracker[3] + counts, tracker[3])
        settled = jnp.where(trusted, settled, 0.0)

        # A voltage error adds up until the rotor has turned by about a radian.
        step = jnp.minimum(jnp.abs(s.speed) * self.sample_time, 1.0)
        exposed = s.exposed + self.h * plausible - s.exposed * step
        exposed = jnp.minimum(exposed, C.EXPOSED_MOST)
        steady = exposed < C.VOLTAGE_LIMIT * length

        after = s._replace(
            length=length,
            exposed=exposed,
            theta=theta,
            swept=swept,
            flux=jnp.where(trusted, flux, jnp.where(carries, carried_flux, s.flux)),
            drift=jnp.where(trusted, drift, s.drift),
            variance=jnp.where(trusted, own_variance, s.variance),
            growth=jnp.where(carries, growth, s.growth),
            carried=jnp.where(trusted, 0.0, jnp.where(carries, carried, s.carried)),
            carried_length=jnp.where(carries, carried_length, s.carried_length),
            carried_off=jnp.where(carries, off, s.carried_off),
            trusted=trusted,
            have_carried=s.have_carried | trusted,
            angle=tracker[0],
            speed=tracker[1],
            acceleration=tracker[2],
            settled=settled,
            lost=tracker[4],
        )
        return after, Reading(
            out_flux * self.flux_base,
            length * self.flux_base,
            out_theta,
            tracker[0],
            tracker[1],
            out_drift * self.drift_base,
            std,
            trusted & (settled >= C.TRACKER_SETTLED) & (std < C.STD_LIMIT) & steady,
            s.innovation,
            s.noise_share,
        )

    def _taken_turn(
        self, s: TwinState, inverse: Array, p: Array, square: Array, long_enough: Array
    ) -> TwinState:
        """Re-injects a prior row, or judges how sure the least squares is."""
        judges = s.turn % 2 == 1
        turned = self._judged(s, inverse, p, square)
        judged = select(long_enough, turned, s._replace(noise_share=jnp.ones(())))
        s = select(judges, judged, s._replace(triangle=self._reinjected(s)))
        return s._replace(turn=(s.turn + 1) % PERIOD)

    def _judged(self, s: TwinState, inverse: Array, p: Array, square: Array) -> TwinState:
        """Variance of the angle of p, and what of the flux's information is only noise."""
        drift_prior = s.prior_scale / self.prior[4]
        excess = s.x[DRIFT] @ s.x[DRIFT] / drift_prior**2
        flux = inverse[FLUX]
        across = jnp.sum((p[1] * flux[0] - p[0] * flux[1]) ** 2) / square
        n0, n1, n2 = s.noise
        pretended = n0 - jnp.where(n2 > 0, n1**2 / jnp.where(n2 > 0, n2, 1.0), 0.0)
        r1 = jnp.clip(s.lag_one / s.power, 0.0, C.CORRELATION_LIMIT)
        r1 = jnp.where(s.power > 0, r1, 0.0)
        inflation = self.h * s.power * (1 + r1) / (1 - r1)
        # A prior that is wrong is forgotten slowly: widen it, and let what it did count for little.
        widen = (excess > 1) & s.trusted & (jnp.abs(s.swept) > C.SETTLED)
        keep = jnp.where(widen, C.DISTRUST / excess, 1.0)
        return s._replace(
            noise_share=pretended * jnp.sum(flux**2),
            inflation=inflation,
            spread=inflation * across / square * jnp.maximum(excess, 1.0),
            triangle=jnp.sqrt(keep) * s.triangle,
            noise=keep * s.noise,
            prior_scale=jnp.where(widen, np.sqrt(C.WIDEN) * jnp.sqrt(excess), 1.0) * s.prior_scale,
        )

    def _track(self, s: TwinState, theta: Array, stop: Array) -> tuple[Array, ...]:
        """Fading-memory filter of second order; stopped at theta where nothing is known.

        Angle, speed, acceleration, settled, lost.
        """
        h = self.sample_time
        step = h * (s.speed + h * s.acceleration / 2)
        stop = stop | ~(jnp.abs(step) <= np.pi)
        error = wrap(theta - wrap(s.angle + step))
        resumes = ~stop & s.lost
        lost = ~stop & ~s.lost & ~(jnp.abs(error) <= C.TRACKER_LOST)
        angle = wrap(s.angle + step + self.track[0] * error)
        speed = s.speed + h * s.acceleration + self.track[1] * error
        acceleration = s.acceleration + self.track[2] * error
        anew = stop | lost | resumes
        turned = jnp.where(resumes, wrap(theta - s.angle) / h, 0.0)
        return (
            jnp.where(anew, theta, angle),
            jnp.where(anew, turned, speed),
            jnp.where(anew, 0.0, acceleration),
            jnp.where(lost, 0.0, s.settled),
            lost,
        )

    def _reinjected(self, s: TwinState) -> Array:
        """One prior row in turn, aimed at the estimate: bounds the deviations, moves nothing."""
        scale = s.prior_scale**PRIOR_POWER
        row = jnp.where(jnp.arange(SIZE) == s.turn // 2, self.reinject / scale, 0.0)
        return absorb(s.triangle, jnp.append(row, row @ s.x))[0]

    # ---- samples -------------------------------------------------------------------------

    def _ahead(self, s: TwinState, before: Array) -> Array:
        """What is missing is taken to have gone on turning with the rotor, if that is known."""
        half = jnp.where(s.trusted, s.speed * self.sample_time / 2, 0.0)
        cosine, sine = (1 - half**2) / (1 + half**2), 2 * half / (1 + half**2)
        alpha, beta = before[0], before[1]
        return jnp.stack([cosine * alpha - sine * beta, sine * alpha + cosine * beta])

    def _volt_seconds(self, currents: Array, source: Array, complete: bool) -> Array:
        """Per-unit volt-seconds; the mean current from the cubic through four samples."""
        if complete:
            return source
        mean = 9 * currents[0] + 19 * currents[1] - 5 * currents[2] + currents[3]
        return source - self.hR @ mean

    def _advance(
        self, state: TwinState, source: Array, current: Array, complete: bool
    ) -> tuple[TwinState, Reading]:
        s = state
        source_finite = jnp.isfinite(source).all()
        current_finite = jnp.isfinite(current).all()
        source = jnp.where(source_finite, source, 0.0)
        current = jnp.where(current_finite, current, 0.0)
        absurd = ~(current @ current <= self.current_limit**2) | ~(
            source @ source <= C.FLUX_STEP_LIMIT**2
        )
        good = current_finite & ~absurd
        missing = ~current_finite | (~source_finite & s.have_voltage)
        takes = ~absurd & (good | s.have_current)

        # The sample comes in; before the first one the current is taken to have been what it is.
        newest = jnp.where(good, current, self._ahead(s, s.currents[0]))
        shifted = jnp.concatenate([newest[None], s.currents[:3]])
        currents = jnp.where(s.have_current, shifted, jnp.stack([newest] * 4))
        new_source = takes & source_finite & s.have_current
        s = s._replace(
            currents=jnp.where(takes, currents, s.currents),
            source=jnp.where(
                new_source, source, jnp.where(takes, self._ahead(s, s.source), s.source)
            ),
            have_voltage=s.have_voltage | new_source,
            have_current=s.have_current | takes,
        )
        v = self._volt_seconds(s.currents, s.source, complete)
        connected = s.have_voltage
        v = jnp.where(connected, v, 0.0)
        s = select(connected | ~takes, s, self._empty(s))
        step = jnp.linalg.norm(v - self.L_position * (s.currents[0] - s.currents[1]))
        jump = C.STEP_NOISE * jnp.sqrt(self.position_noise * self._roughness(s))
        row = self._relation(current)
        leaps = step > 2 * s.step + C.STEP_LIMIT * s.length + jump
        contradicted = takes & good & s.trusted & (leaps | self._contradicts(s, v, row))

        # A sample that contradicts all before is passed over as if it were missing.
        held = s.currents.at[0].set(self._ahead(s, s.currents[1]))
        v = jnp.where(contradicted, self._volt_seconds(held, s.source, complete), v)
        s = s._replace(
            currents=jnp.where(contradicted, held, s.currents),
            step=jnp.where(takes & connected & ~contradicted, step, s.step),
            outliers=s.outliers + contradicted,
        )
        s = select(takes & connected, self._predict(s, v), s)
        s = select(takes & good & ~contradicted, self._measure(s, row), s)
        v = jnp.where(takes, v, 0.0)

        consecutive = jnp.where(missing | contradicted, s.consecutive_bad + 1, 0)
        restart = absurd | (s.have_current & (consecutive > C.MAX_CONSECUTIVE_BAD))
        s = s._replace(consecutive_bad=consecutive, restarts=s.restarts + restart)
        s = select(restart, self._restarted(s), s)
        s, reading = self._read_out(s, v)
        return s, reading._replace(valid=reading.valid & ~(missing | contradicted))

    @property
    def memory(self) -> Array:
        """Exponential memory [s]."""
        return self.sample_time / self.h

    def run(self, voltage: Any, current: Any) -> Estimate:
        """A whole record from zero knowledge, (rows, 2) each; as :meth:`LeastSquaresObserver.run`
        on arrays: row k's voltage is the mean over the interval that ends at row k."""
        found = _run(self, jnp.asarray(voltage, float), jnp.asarray(current, float))
        return Estimate(**{name: np.asarray(value) for name, value in found._asdict().items()})


@eqx.filter_jit
def _run(observer: SquareRootLeastSquares, voltage: Array, current: Array) -> Reading:
    def body(state: TwinState, row: tuple[Array, Array]) -> Any:
        return observer.step(state, *row)

    return jax.lax.scan(body, observer.init(), (voltage, current))[1]  # type: ignore[no-any-return]


def select(condition: Array, yes: TwinState, no: TwinState) -> TwinState:
    """One of two states."""
    chosen: TwinState = jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)
    return chosen


def _barrier(array: Array) -> Array:
    """The same array, which XLA computes once and not anew for every element after it."""
    barrier: Any = jax.lax.optimization_barrier
    kept: Array = barrier(array)
    return kept


def absorb(triangle: Array, row: Array) -> tuple[Array, Array]:
    """Rotates a row into R x = z (Givens); returns the triangle and what is left of its z."""
    rows = []
    for i in range(SIZE):
        old = triangle[i]
        square = old[i] ** 2 + row[i] ** 2
        inverse = jnp.sqrt(square) / square
        cosine, sine = old[i] * inverse, row[i] * inverse
        rotated = _barrier(jnp.stack([cosine * old + sine * row, cosine * row - sine * old]))
        rows.append(rotated[0])
        row = rotated[1]
    return jnp.stack(rows), row[Z]


def invert(R: Array) -> Array:
    """Inverse of an upper triangle."""
    diagonal = 1 / jnp.diagonal(R)
    left, rows = jnp.eye(SIZE), []
    for i in reversed(range(SIZE)):
        row = left[i] * diagonal[i]
        rows.append(row)
        left = _barrier(left - R[:, i, None] * row)
    return jnp.stack(rows[::-1])


def wrap(angle: Array) -> Array:
    """Into (-π, π]."""
    return angle - 2 * np.pi * jnp.ceil((angle - np.pi) / (2 * np.pi))
