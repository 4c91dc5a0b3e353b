"""The production least squares in JAX: readable, differentiable, batched, usable inside a loop.

Twin of firmware/fluxobs.c, function by function, in double precision; equal to it to rounding over
whole records. It makes it possible to simulate closed loops with the observer, many at once. It
omits only how the C core handles numbers that have run away. docs/theory.md, sections 4 to 6,
explains each step.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, NamedTuple, Self, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ... import _core
from ...machines.model.held import kink_weights
from ...observers import Estimate, LeastSquaresObserver
from .flux_map import Map
from .flux_map import direction as expected
from .vectors import pair, vector

#: Thresholds of the compiled observer; firmware/fluxobs_internal.h gives the reasons.
C: SimpleNamespace = SimpleNamespace(**_core.thresholds)
STD_UNKNOWN = np.sqrt(C.VARIANCE_UNKNOWN)
SIZE = 7
#: Samples alternate: one re-injects a prior row, the next judges the certainty.
PERIOD = int(C.REINJECT_PERIOD)
#: Columns of the information triangle: s, flux, kappa, drift, c, and the right side.
S, FLUX, KAPPA, DRIFT, CC, Z = 0, slice(1, 3), 3, slice(4, 6), 6, 7
PRIOR_POWER = np.array([0, 0, 0, 1, 1, 1, 2])


class Shape(NamedTuple):
    """What the machine's flux map says of the present current; per-unit, vectors (2,)."""

    away: Array  # position vector = flux - away
    centre: Array  # |flux - centre|² - square does not change
    square: Array
    active: Array  # length of the position vector by the map; of a cage, its growth
    rotor: Array  # growth of a cage's flux so far
    magnetizing: Array  # the current that would keep it [A]; 0: unknown
    outside: Array


class TwinState(NamedTuple):
    """State of the observer; per-unit (flux base, memory) unless a unit is given."""

    triangle: Array  # (7, 8): R | z of R x = z, x = (s, flux, kappa, drift, c)
    x: Array  # (7,) solution of R x = z
    noise: Array  # (3,) information from noise alone: flux, flux-drift, drift
    currents: Array  # (4, 2) last currents, newest first [A]
    source: Array  # (2,) last good volt-seconds
    given: Array  # (2,) before kinks were taken from them, ...
    kink: Array  # (2,) ... and their last step
    step: Array  # change of the position vector over the last interval
    length: Array  # |flux - L i|
    rough: Array  # variance of a current component, from its roughness [A²]
    exposed: Array  # turn from a plausible voltage error, at the flux base [rad]
    innovation: Array
    power: Array
    lag_one: Array
    noise_share: Array  # last judged value
    inflation: Array
    spread: Array  # variance of the least squares' angle [rad²]
    prior_scale: Array  # factor by which the drift prior proved too tight
    theta: Array  # angle of the least squares [rad]
    swept: Array  # angle turned since it is known [rad]
    flux: Array  # (2,) last trusted
    drift: Array  # (2,) last trusted
    variance: Array  # variance of the carried position at its start [rad²]
    growth: Array
    carried: Array  # duration of carrying on
    carried_length: Array  # length of the position vector when carrying began
    carried_off: Array  # largest squared relative change of that length since
    angle: Array  # tracker: angle, speed, acceleration [rad], [rad/s], [rad/s²]
    speed: Array
    acceleration: Array
    settled: Array  # how long the tracker has been close
    lost: Array  # the tracker takes its speed from the next angle
    have_current: Array
    have_voltage: Array
    trusted: Array
    have_carried: Array
    turn: Array
    consecutive_bad: Array
    restarts: Array
    outliers: Array
    shape: Shape


class Reading(NamedTuple):
    """Estimate of one sample; fields as in :class:`fluxobs.observers.Estimate`."""

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

    Create it with :meth:`of`. Every field is an array: the same object with stacked leaves is a
    batch of observers for a batch of machines.

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
    kinks: Array  # (2,) what a step of the voltage takes from its volt-seconds, now and one later
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
    flux_map: Map | None = None

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
            "kinks": kink_weights(observer.held),
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
        flux_map = None if observer.flux_map is None else Map.of(observer.flux_map)
        arrays = {name: jnp.asarray(value, float) for name, value in values.items()}
        return cls(**arrays, flux_map=flux_map)

    def init(self) -> TwinState:
        """State without any knowledge."""
        zero, both, no = jnp.zeros(()), jnp.zeros(2), jnp.zeros((), bool)
        names = TwinState._fields
        blank: dict[str, Any] = dict.fromkeys(names, zero)
        blank |= dict.fromkeys(("source", "given", "kink", "flux", "drift"), both)
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
            "shape": Shape(both, both, zero, zero, zero, zero, no),
        }
        return self._restarted(TwinState(**blank))

    def step(self, state: TwinState, voltage: Array, current: Array) -> tuple[TwinState, Reading]:
        """One sample: mean voltage over the interval ending now [V], the current now [A]."""
        source = self.hB @ voltage
        good = jnp.isfinite(source).all() & (source @ source <= C.FLUX_STEP_LIMIT**2)
        kink = jnp.where(state.have_voltage, source - state.given, 0.0)
        s = state._replace(
            given=jnp.where(good, source, state.given), kink=jnp.where(good, kink, state.kink)
        )
        before = jnp.where(state.have_voltage, state.kink, 0.0)
        less = source - self.kinks[0] * kink - self.kinks[1] * before
        source = jnp.where(good, less, source)
        return self._advance(s, source, current, complete=False)

    def step_volt_seconds(
        self, state: TwinState, volt_seconds: Array, current: Array
    ) -> tuple[TwinState, Reading]:
        """Like :meth:`step`, with the exact volt-seconds ∫(-R i + B u) dt of the interval [Wb]."""
        return self._advance(state, volt_seconds / self.flux_base, current, complete=True)

    # ---- square-root information filter --------------------------------------------------

    @property
    def _rho(self) -> Array:
        return 1 - self.h

    def _empty(self, s: TwinState) -> TwinState:
        """Resets the information to the prior, and the innovations to their assumed level."""
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

    def _shape(self, s: TwinState, before: Shape) -> Shape:
        """Asks the map about the newest current, at the angle where the tracker expects the
        rotor; `before` is what it said of the last one."""
        current, m, base = s.currents[0], self.flux_map, self.flux_base
        if m is None:
            return before._replace(away=self.L_position * current)
        step = self._expected_step(s)
        angle = jnp.where(jnp.abs(step) <= np.pi, wrap(s.angle + step), s.angle)
        direction = expected(angle)
        i = vector(current) * jnp.conj(direction)
        rotor, square, magnetizing = before.rotor, before.square, before.magnetizing
        if m.cage:
            known = jnp.where(s.trusted, magnetizing, 0.0)
            off = i.real - known
            grown = m.decay * off * off**2 / (off**2 + m.still**2)
            follows = known > m.still
            ratio = jnp.where(follows, grown / jnp.where(follows, known, 1.0), 0.0)
            rotor = rotor + ratio * s.length
            square = square + 2 * ratio * s.length**2
            held = jnp.where(s.trusted, i.real, known)
            magnetizing = jnp.where(follows, known + grown, held)
        flux, by_d, by_q = m.at(i, rotor * base)
        # a = F + j J(j i)
        a = (flux + 1j * (by_q * i.real - by_d * i.imag)) / base
        share = 1.0 if m.magnets else 0.5
        away = direction * (flux / base - a.real)
        centre = direction * (flux / base - share * a)
        if not m.cage:
            square = share**2 * (a.real**2 + a.imag**2) - (m.psi / base) ** 2
        active = a.real if m.cage else jnp.abs(a.real)
        outside = m.outside(i)
        return Shape(pair(away), pair(centre), square, active, rotor, magnetizing, outside)

    def _relation(self, shape: Shape, current: Array) -> Array:
        """Row and right-hand side of 0 = s + (Q2 i)ᵀflux + iᵀQ3 i + Cᵀi, divided by its noise; with
        a map, of 0 = s - 2 centreᵀflux + |centre|² - square."""
        if self.flux_map is not None:
            rhs = self.row_s * (shape.square - shape.centre @ shape.centre)
            row = [self.row_s[None], -2 * self.row_s * shape.centre, jnp.zeros(4), rhs[None]]
            return jnp.concatenate(row)
        rhs = -(self.row_C @ current + current @ self.row_Q3 @ current)
        row = [self.row_s[None], self.row_Q2 @ current, jnp.zeros(4), rhs[None]]
        return jnp.concatenate(row)

    def _contradicts(self, s: TwinState, v: Array, row: Array) -> Array:
        """Whether the measurement is far from the prediction of the last estimate."""
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
        """Reads out the flux of the least squares if trusted, else carries the last trusted on."""
        inverse = invert(s.triangle[:, :SIZE])
        x = inverse @ s.triangle[:, Z]
        away, active = s.shape.away, self._active(s)
        p = x[FLUX] - away
        flux, drift = x[FLUX], x[DRIFT]
        square = p @ p
        theta = jnp.arctan2(p[1], p[0])
        long_enough = square > self.length_min**2
        s = self._taken_turn(s._replace(x=x), inverse, p, square, long_enough)
        known = long_enough & (s.noise_share < C.SHARE_LIMIT)
        swept = jnp.where(known, s.swept + wrap(theta - s.theta), 0.0)
        trusted = known & (s.trusted | (jnp.abs(swept) > C.SWEEP))

        # Trusted: variance from the covariance across p, and from the current noise in p.
        floor = self.position_noise * self._roughness(s)
        own_variance = s.spread + floor / square
        if self.flux_map is not None and self.flux_map.cage:
            corner = self.flux_map.decay / self.sample_time
            own_variance += self.flux_map.ripple**2 / (s.speed**2 + corner**2)
        # Not trusted: integrate on from the last trusted flux.
        start = s.flux - away
        begins = s.carried == 0
        plausible = 1 / self.prior[4]
        start_square = start @ start
        across = (start[1] * inverse[4] - start[0] * inverse[5]) ** 2
        grows = (s.inflation * jnp.sum(across) / start_square + plausible**2) / start_square
        growth = jnp.where(begins, grows, s.growth)
        carried_length = jnp.where(begins, jnp.sqrt(start_square) - active, s.carried_length)
        carried = s.carried + self.h
        carried_flux = s.flux + v + self.h * s.drift
        # An error of the drift shows in the length, which should stay as the map says.
        now = carried_flux - away
        usual = carried_length + active
        usual = jnp.where(usual > C.SHORTEST_ACTIVE, usual, C.SHORTEST_ACTIVE)
        off = jnp.sqrt(now @ now) / usual - 1
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
        p = out_flux - away
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

        valid = trusted & (settled >= C.TRACKER_SETTLED) & (std < C.STD_LIMIT) & steady
        if self.flux_map is not None:
            # the rows before asked the map at wrong angles
            keep = jnp.where(trusted & ~s.trusted, C.DISTRUST, 1.0)
            s = s._replace(triangle=jnp.sqrt(keep) * s.triangle, noise=keep * s.noise)
            at_the_rotor = jnp.abs(wrap(out_theta - tracker[0])) < C.STD_LIMIT
            valid = valid & at_the_rotor & ~s.shape.outside

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
            valid,
            s.innovation,
            s.noise_share,
        )

    def _active(self, s: TwinState) -> Array:
        """What the map says of the length of the position vector: it is not constant then."""
        return jnp.zeros(()) if self.flux_map is None else s.shape.active

    def _expected_step(self, s: TwinState) -> Array:
        """Angle by which the tracker expects the rotor to turn in a sample."""
        return self.sample_time * (s.speed + self.sample_time * s.acceleration / 2)

    def _taken_turn(
        self, s: TwinState, inverse: Array, p: Array, square: Array, long_enough: Array
    ) -> TwinState:
        """Re-injects a prior row or judges the certainty, in turn."""
        judges = s.turn % 2 == 1
        turned = self._judged(s, inverse, p, square)
        judged = select(long_enough, turned, s._replace(noise_share=jnp.ones(())))
        s = select(judges, judged, s._replace(triangle=self._reinjected(s)))
        return s._replace(turn=(s.turn + 1) % PERIOD)

    def _judged(self, s: TwinState, inverse: Array, p: Array, square: Array) -> TwinState:
        """Variance of the angle of p, and the share of the flux information that is only noise."""
        drift_prior = s.prior_scale / self.prior[4]
        excess = s.x[DRIFT] @ s.x[DRIFT] / drift_prior**2
        flux = inverse[FLUX]
        across = jnp.sum((p[1] * flux[0] - p[0] * flux[1]) ** 2) / square
        n0, n1, n2 = s.noise
        pretended = n0 - jnp.where(n2 > 0, n1**2 / jnp.where(n2 > 0, n2, 1.0), 0.0)
        r1 = jnp.clip(s.lag_one / s.power, 0.0, C.CORRELATION_LIMIT)
        r1 = jnp.where(s.power > 0, r1, 0.0)
        inflation = self.h * s.power * (1 + r1) / (1 - r1)
        # A wrong prior is forgotten slowly: widen it, and discount the information it influenced.
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
        """Second-order fading-memory filter; held at theta while nothing is known.

        Returns angle, speed, acceleration, settled, lost.
        """
        h = self.sample_time
        step = self._expected_step(s)
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
        """Adds one prior row in turn, centred on the estimate: bounds the stds, moves nothing."""
        scale = s.prior_scale**PRIOR_POWER
        row = jnp.where(jnp.arange(SIZE) == s.turn // 2, self.reinject / scale, 0.0)
        return absorb(s.triangle, jnp.append(row, row @ s.x))[0]

    # ---- samples -------------------------------------------------------------------------

    def _ahead(self, s: TwinState, before: Array) -> Array:
        """Substitute for a missing sample: the last one, turned with the rotor if known."""
        half = jnp.where(s.trusted, s.speed * self.sample_time / 2, 0.0)
        cosine, sine = (1 - half**2) / (1 + half**2), 2 * half / (1 + half**2)
        alpha, beta = before[0], before[1]
        return jnp.stack([cosine * alpha - sine * beta, sine * alpha + cosine * beta])

    def _volt_seconds(self, currents: Array, source: Array, complete: bool) -> Array:
        """Per-unit volt-seconds; a cubic through four samples gives the mean current."""
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

        # Shift in the sample; assume that the current was constant before the first one.
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
        before = s.shape
        s = s._replace(shape=select(takes, self._shape(s, before), before))
        moved = self.L_position * (s.currents[0] - s.currents[1])
        if self.flux_map is not None:
            moved = s.shape.away - before.away
        step = jnp.linalg.norm(v - moved)
        jump = C.STEP_NOISE * jnp.sqrt(self.position_noise * self._roughness(s))
        row = self._relation(s.shape, current)
        leaps = step > 2 * s.step + C.STEP_LIMIT * s.length + jump
        contradicted = takes & good & s.trusted & (leaps | self._contradicts(s, v, row))

        # Treat a sample that contradicts the earlier ones as missing.
        held = s.currents.at[0].set(self._ahead(s, s.currents[1]))
        v = jnp.where(contradicted, self._volt_seconds(held, s.source, complete), v)
        s = s._replace(
            currents=jnp.where(contradicted, held, s.currents),
            step=jnp.where(takes & connected & ~contradicted, step, s.step),
            outliers=s.outliers + contradicted,
        )
        s = s._replace(shape=select(contradicted, self._shape(s, before), s.shape))
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
        """Runs a whole record from zero knowledge, (rows, 2) each.

        Like :meth:`LeastSquaresObserver.run` on arrays: row k's voltage is the mean over the
        interval that ends at row k.
        """
        found = _run(self, jnp.asarray(voltage, float), jnp.asarray(current, float))
        return Estimate(**{name: np.asarray(value) for name, value in found._asdict().items()})


@eqx.filter_jit
def _run(observer: SquareRootLeastSquares, voltage: Array, current: Array) -> Reading:
    def body(state: TwinState, row: tuple[Array, Array]) -> Any:
        return observer.step(state, *row)

    return jax.lax.scan(body, observer.init(), (voltage, current))[1]  # type: ignore[no-any-return]


State = TypeVar("State")


def select(condition: Array, yes: State, no: State) -> State:
    """Selects one of two states."""
    chosen: State = jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)
    return chosen


def _barrier(array: Array) -> Array:
    """The same array; XLA computes it once, not again for every element that uses it."""
    barrier: Any = jax.lax.optimization_barrier
    kept: Array = barrier(array)
    return kept


def absorb(triangle: Array, row: Array) -> tuple[Array, Array]:
    """Rotates a row into R x = z (Givens); returns the triangle and the residual of the row."""
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
    """Inverse of an upper triangular matrix."""
    diagonal = 1 / jnp.diagonal(R)
    left, rows = jnp.eye(SIZE), []
    for i in reversed(range(SIZE)):
        row = left[i] * diagonal[i]
        rows.append(row)
        left = _barrier(left - R[:, i, None] * row)
    return jnp.stack(rows[::-1])


def wrap(angle: Array) -> Array:
    """Wraps an angle into (-π, π]."""
    return angle - 2 * np.pi * jnp.ceil((angle - np.pi) / (2 * np.pi))
