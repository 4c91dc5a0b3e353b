"""The drive simulator agrees with closed forms, conservation laws and independent recursions."""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fluxobs import LeastSquaresObserver
from fluxobs.errors import MachineError, ModelError
from fluxobs.machines import SurfacePMSM, example
from fluxobs.simulation.drive import (
    Control,
    Course,
    Drive,
    Inverter,
    Mechanics,
    Motor,
    Plant,
    Profile,
    Sensorless,
    Sensors,
    rms,
    rpm,
    simulate,
    simulate_batch,
    to_rms,
    to_rpm,
)
from fluxobs.simulation.drive.loop_observer import LoopObserver
from fluxobs.simulation.drive.vectors import from_phases, phases, turn

H = 1.25e-4
MACHINES = {name: Motor.of(example(name)) for name in ("pmsm-2kw2", "ipm-2kw2", "synrm-6kw7")}


def drive(motor=MACHINES["pmsm-2kw2"], inverter=None, sensors=None, J=0.015, limit=9.0, **control):
    return Drive(
        Plant(motor, Mechanics(J)),
        inverter or Inverter(),
        sensors or Sensors(),
        Control.of(motor, J, H, limit, **control),
    )


# ---- units and vectors -----------------------------------------------------------------------


def test_unit_conversions():
    assert rpm(60.0) == pytest.approx(2 * np.pi)
    assert to_rpm(rpm(1234.0)) == pytest.approx(1234.0)
    assert to_rms(rms(4.3)) == pytest.approx(4.3)
    assert rms(1.0) == pytest.approx(np.sqrt(2))


def test_phases_and_back():
    z = jnp.asarray([1 + 2j, -3j])
    abc = phases(z)
    assert np.allclose(abc.sum(axis=-1), 0)
    assert np.allclose(abc[0, 0], 1.0)
    assert np.allclose(from_phases(abc + 5.0), z)


def test_profiles_jump_and_hold():
    profile = Profile([1.0, 2.0, 2.0], [0.0, 4.0, 9.0])
    assert np.allclose(profile.at(jnp.asarray([0.0, 1.5, 2.0, 7.0])), [0.0, 2.0, 9.0, 9.0])
    with pytest.raises(ModelError, match=r"must not decrease, got 2 s before 1"):
        Profile([2.0, 1.0], [0.0, 1.0])


# ---- plant -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=() if name == "ipm-2kw2" else pytest.mark.slow) for name in MACHINES],
)
def test_power_balance(name):
    """Electrical input = copper loss + field + mechanical output, with a spinning rotor."""
    motor = MACHINES[name]
    plant = Plant(motor, Mechanics(0.002, viscous=1e-3, coulomb=0.05))
    h, rows = 2e-6, 10000
    voltage = 60 * np.exp(1j * (0.3 + 250.0 * h * np.arange(rows)))

    def body(state, u):
        i = plant.current(state)
        power = jnp.stack(
            [
                1.5 * (u * jnp.conj(i)).real,
                1.5 * motor.R_s * (i * jnp.conj(i)).real,
                plant.mechanics.resisting(state.speed) * state.speed,
            ]
        )
        # Use Simpson's rule over the step, with the state after half a step.
        half = plant.advance(state, u, jnp.zeros(()), jnp.asarray(h / 2), 1)
        after = plant.advance(half, u, jnp.zeros(()), jnp.asarray(h / 2), 1)

        def powers(s):
            i = plant.current(s)
            return jnp.stack(
                [
                    1.5 * (u * jnp.conj(i)).real,
                    1.5 * motor.R_s * (i * jnp.conj(i)).real,
                    plant.mechanics.resisting(s.speed) * s.speed,
                ]
            )

        return after, h / 6 * (power + 4 * powers(half) + powers(after))

    start = plant.standstill(0.4, 20.0)
    run = jax.jit(lambda u: jax.lax.scan(body, start, u))
    end, work = run(jnp.asarray(voltage))
    electrical, copper, friction = np.asarray(work).sum(axis=0)

    def stored(s):
        return float(
            motor.field_energy(plant.current(s), s.rotor) + plant.mechanics.J * s.speed**2 / 2
        )

    increase = stored(end) - stored(start)
    assert abs(electrical) > 0.1
    assert electrical - copper - friction == pytest.approx(increase, abs=1e-8 * abs(electrical))


def test_locked_rotor_follows_its_time_constant():
    motor = MACHINES["pmsm-2kw2"]
    plant = Plant(motor, Mechanics(1e9))
    state = plant.standstill(0.0)
    u, tau = 10.0, float(motor.L_d / motor.R_s)
    for _ in range(20):
        state = plant.advance(state, jnp.asarray(u + 0j), jnp.zeros(()), jnp.asarray(tau / 20), 2)
    expected = u / float(motor.R_s) * (1 - np.exp(-1))
    assert complex(plant.current(state)) == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize("elastic", [False, True])
def test_against_an_independent_solver(elastic):
    """SciPy's solution of a salient machine in rotor coordinates agrees with the plant."""
    m = example("ipm-2kw2")
    coupling = {"J_load": 0.01, "stiffness": 200.0, "damping": 0.02} if elastic else {}
    mechanics = Mechanics(0.004, viscous=2e-3, fan=1e-4, **coupling)
    plant = Plant(Motor.of(m), mechanics)
    u0, load, T = 80 * np.exp(0.5j), 1.5, 0.05

    def rate(t, y):
        psi_d, psi_q, w, theta, w2, twist = y
        i_d, i_q = (psi_d - m.psi_f) / m.L_d, psi_q / m.L_q
        u = u0 * np.exp(-1j * theta)
        we = m.n_p * w
        torque = 1.5 * m.n_p * (psi_d * i_q - psi_q * i_d)
        w_end = w2 if elastic else w
        resisting = 2e-3 * w_end + 1e-4 * w_end * abs(w_end)
        if elastic:
            shaft = 200.0 * twist + 0.02 * (w - w2)
            dw, dw2 = (torque - shaft) / 0.004, (shaft - load - resisting) / 0.01
        else:
            dw = dw2 = (torque - load - resisting) / 0.004
        return [
            u.real - m.R_s * i_d + we * psi_q,
            u.imag - m.R_s * i_q - we * psi_d,
            dw,
            we,
            dw2,
            w - w2 if elastic else 0.0,
        ]

    start = [m.psi_f, 0.0, 5.0, 0.3, 5.0, 0.0]
    solution = solve_ivp(rate, (0, T), start, rtol=1e-11, atol=1e-12).y[:, -1]
    state = plant.standstill(0.3, 5.0)
    rows = 800
    step = jax.jit(
        lambda s: plant.advance(s, jnp.asarray(u0), jnp.asarray(load), jnp.asarray(T / rows), 1)
    )
    for _ in range(rows):
        state = step(state)
    x = complex(state.flux * np.conj(state.rotor))
    assert x == pytest.approx(solution[0] + 1j * solution[1], abs=1e-8)
    assert float(state.speed) == pytest.approx(solution[2], abs=1e-6)
    assert np.angle(complex(state.rotor) * np.exp(-1j * solution[3])) == pytest.approx(0, abs=1e-8)
    if elastic:
        assert float(state.load_speed) == pytest.approx(solution[4], abs=1e-6)
        assert float(state.twist) == pytest.approx(solution[5], abs=1e-8)


# ---- inverter --------------------------------------------------------------------------------


def test_an_ideal_inverter_makes_the_commanded_voltage():
    inverter = Inverter()
    for u in (100 + 50j, -200j, 310 * np.exp(1j * np.pi / 6)):
        duties = inverter.duties(jnp.asarray(u), jnp.asarray(540.0))
        assert ((duties >= 0) & (duties <= 1)).all()
        voltage = inverter.averaged(duties, jnp.asarray(540.0), jnp.asarray(1j), jnp.asarray(H))
        assert complex(voltage) == pytest.approx(u, abs=1e-9)


@pytest.mark.parametrize("current", [5 * np.exp(0.4j), 3 * np.exp(2.9j), 4 * np.exp(-1.0j)])
def test_switching_and_averaged_inverter_agree_over_a_period(current):
    flaws = {"dead_time": 2e-6, "drop": 1.1, "R_on": 0.05, "smoothing": 1e-3}
    averaged, parts = Inverter(**flaws), 16
    switching = Inverter(**flaws, switching=parts)
    link, h, i = jnp.asarray(540.0), jnp.asarray(H), jnp.asarray(current)
    duties = averaged.duties(jnp.asarray(120 * np.exp(1.1j)), link)
    mean = sum(switching.switched(duties, link, i, h, jnp.asarray(k)) for k in range(parts)) / parts
    assert complex(mean) == pytest.approx(complex(averaged.averaged(duties, link, i, h)), abs=1e-9)
    # Both inverters lose the voltage of dead time and drop, opposite to the phase currents.
    signs = np.sign(np.asarray(phases(i)))
    lost = complex(from_phases(jnp.asarray((2e-6 / H * 540 + 1.1) * signs)))
    assert complex(mean) == pytest.approx(120 * np.exp(1.1j) - lost - 0.05 * current, abs=1e-6)


@pytest.mark.parametrize("share", [0.2, 0.9, 1.5])
def test_a_loss_larger_than_the_current_stops_it_without_oscillation(share):
    """Without resistance the current settles where the loss is the commanded voltage, or rises.

    An explicit step overshoots if the loss moves the current by more than the smoothing.
    """
    h, L, smoothing, link = 50e-6, 20e-6, 0.4, jnp.asarray(15.0)
    inverter = Inverter(dead_time=1.5e-6, smoothing=smoothing)
    lost = 1.5e-6 / h * 15.0
    assert lost * h / L > 2 * smoothing
    u = share * lost
    duties, i = inverter.duties(jnp.asarray(u + 0j), link), jnp.asarray(1.0 + 0j)
    half = h / (2 * L)

    @jax.jit
    def step(i):
        middle = inverter.middle_current(
            i, i + half * u, jnp.asarray(half + 0j), jnp.asarray(1j * half), link, jnp.asarray(h)
        )
        return i + h / L * inverter.averaged(duties, link, middle, jnp.asarray(h))

    for _ in range(60):
        i = step(i)

    def rate(_: float, x: np.ndarray) -> np.ndarray:
        a, b = np.tanh(x[0] / smoothing), np.tanh(-x[0] / 2 / smoothing)
        return np.array([(u - lost * (2 * a - 2 * b) / 3) / L])

    exact = solve_ivp(rate, (0, 60 * h), [1.0], method="LSODA", rtol=1e-9, atol=1e-12).y[0, -1]
    assert complex(i) == pytest.approx(exact, rel=2e-3)


@pytest.mark.slow
def test_switching_and_averaged_drive_agree():
    """Pulses are centred in the sample, so sampled currents have no ripple."""
    flaws = {"dead_time": 1e-6, "drop": 1.0, "smoothing": 0.2}
    course = Course(Profile([0.0, 0.1], [0.0, 40.0]), 540.0, load=5.0, start_speed=0.0)
    runs = [
        simulate(drive(inverter=Inverter(**flaws, switching=parts)), course, 0.2)
        for parts in (0, 64)
    ]
    averaged, switching = (run.trace for run in runs)
    assert np.abs(switching.speed - averaged.speed).max() < 0.02 * np.abs(averaged.speed).max()
    later = slice(800, None)
    size = np.abs(averaged.current[later]).max()
    assert np.abs(switching.current[later] - averaged.current[later]).max() < 0.05 * size


# ---- sensors ---------------------------------------------------------------------------------


def test_each_sensor_flaw():
    one, zero = jnp.asarray(1.0), jnp.zeros(())
    i = jnp.asarray(3 + 4j)

    def measured(**flaws):
        return complex(
            Sensors(**flaws).measure(i, jnp.asarray(100 + 0j), jnp.asarray(0.5j), one + 0j, one)
        )

    assert measured() == pytest.approx(3 + 4.5j)
    assert measured(noise=0.1) == pytest.approx(3.1 + 4.5j)
    assert measured(jitter=1e-3) == pytest.approx(3.1 + 4.5j)
    abc = np.asarray(phases(jnp.asarray(3 + 4.5j)))
    assert measured(gain=(1.1, 1.0, 1.0)) == pytest.approx(
        complex(from_phases(jnp.asarray(abc * [1.1, 1, 1])))
    )
    assert np.abs(np.asarray(phases(jnp.asarray(measured(range=2.0))))).max() < 2.8
    coarse = np.asarray(measured(quantum=0.5))
    assert complex(coarse) == pytest.approx(
        complex(from_phases(jnp.asarray(np.round(abc / 0.5) * 0.5)))
    )
    assert complex(Sensors().measure(i, zero + 0j, zero + 0j, zero + 0j, zero)) == 3 + 4j


def test_jitter_multiplies_the_current_slope():
    """The noise is the deviation of the sampling instant times the true slope of the current."""
    jitter = 1e-6
    d = drive(sensors=Sensors(jitter=jitter))
    run = simulate(d, Course(Profile([0.0, 0.2], [0.0, 100.0]), 540.0, load=8.0), 0.5)
    late = slice(2400, None)
    noise = (run.trace.measured_current - run.trace.current)[late]
    # Slopes just before and after the row, with the voltages of both intervals.
    trace, motor = run.trace, MACHINES["pmsm-2kw2"]
    acted = np.concatenate([[0], trace.voltage[:-1]])
    emf = 1j * motor.n_p * trace.speed * motor.psi_f * np.exp(1j * trace.theta_e)
    lost = motor.R_s * trace.current + emf
    slopes = [np.asarray((u - lost) / motor.L_d)[late] for u in (acted, trace.voltage)]
    expected = jitter * np.sqrt(np.mean(np.abs(slopes) ** 2))
    assert np.sqrt(np.mean(np.abs(noise) ** 2)) == pytest.approx(expected, rel=0.05)


def test_many_steps_in_a_sample_agree_with_few_in_short_samples():
    motor = MACHINES["pmsm-2kw2"]
    plant = Plant(motor, Mechanics(1e-3, J_load=1e-3, stiffness=5e3))
    u, load = jnp.asarray(50 + 20j), jnp.asarray(0.5)
    start = plant.standstill(0.3, 30.0)
    in_one = plant.advance(start, u, load, jnp.asarray(8e-3), 64)
    state = start
    for _ in range(16):
        state = plant.advance(state, u, load, jnp.asarray(5e-4), 4)
    assert complex(in_one.flux) == pytest.approx(complex(state.flux), rel=1e-8)
    assert float(in_one.twist) == pytest.approx(float(state.twist), rel=1e-7)


# ---- control ---------------------------------------------------------------------------------


@pytest.mark.parametrize("name", MACHINES)
def test_maximum_torque_per_ampere(name):
    """The torque equals the command, and no other current of this length gives more torque."""
    motor = MACHINES[name]
    control = Control.of(motor, 0.01, H, 10.0, i_d_min=-10.0)
    for share in (0.1, 0.5, -0.9):
        command = share * float(control.most_torque())
        i = complex(control.current_for(jnp.asarray(command), *jnp.zeros(4)))
        assert float(motor.torque_dq(i.real, i.imag)) == pytest.approx(command, rel=1e-9)
        angles = np.linspace(-np.pi, np.pi, 20001)
        i_d, i_q = abs(i) * np.cos(angles), abs(i) * np.sin(angles)
        largest = np.abs(np.asarray(motor.torque_dq(i_d, i_q))).max()
        assert abs(command) > 0.9995 * largest


def test_current_step_agrees_with_the_discrete_loop():
    """With a locked rotor, every sample agrees with the closed loop's transition matrix."""
    motor = MACHINES["pmsm-2kw2"]
    d = drive(J=1e9, speed_bandwidth=10.0)
    control = d.control
    A = control.current_loop(float(motor.L_d))
    b = np.array([0, float(control.current_bandwidth * motor.L_d), 0.0])
    b[2] = H * float(control.current_bandwidth) ** 2 * float(motor.L_d)

    # Reference: i_d = 2 A.
    plant, rows = d.plant, 60
    state, control_state, pending = plant.standstill(0.0), control.init(), jnp.asarray(0j)
    currents = []
    for _ in range(rows):
        i = plant.current(state)
        currents.append(complex(i))
        control_state, u, _ = control.current_step(
            control_state, jnp.asarray(2 + 0j), i, jnp.zeros(()), jnp.asarray(540.0)
        )
        state = plant.advance(state, pending, jnp.zeros(()), jnp.asarray(H), 1)
        pending = u
    x, expected = np.zeros(3), []
    for _ in range(rows):
        expected.append(x[0])
        x = A @ x + 2 * b
    assert np.allclose(np.real(currents), expected, atol=1e-8)
    assert expected[-1] == pytest.approx(2.0, abs=0.02)


def test_no_load_speed_is_limited_by_the_voltage():
    """If the reference is too high for the DC link, the EMF settles at the usable voltage."""
    motor = MACHINES["pmsm-2kw2"]
    d = drive(J=0.003)
    run = simulate(d, Course(Profile([0.0, 0.5], [0.0, 200.0]), 300.0), 1.5)
    emf = float(motor.n_p) * run.trace.speed[-1] * float(motor.psi_f)
    assert emf == pytest.approx(0.98 * 300 / np.sqrt(3), rel=0.01)
    limited = [event for event in run.events if event.what == "voltage limit met"]
    assert limited
    assert 0.0 < limited[0].at < 1.0


def test_field_weakening_exceeds_that_speed():
    motor = MACHINES["pmsm-2kw2"]
    course = Course(Profile([0.0, 0.5], [0.0, 130.0]), 300.0)
    unweakened = simulate(drive(J=0.003), course, 1.2)
    weakened = simulate(drive(J=0.003, weakening=20.0), course, 1.2)
    assert unweakened.trace.speed[-1] < 115
    assert weakened.trace.speed[-1] == pytest.approx(130.0, rel=0.01)
    assert weakened.trace.current_reference[-1].real < -1.0
    assert np.abs(weakened.trace.current[-1]) < float(motor.psi_f / motor.L_d)


@pytest.mark.parametrize("name", MACHINES)
def test_speed_control_holds_a_load(name):
    d = drive(MACHINES[name], limit=20.0)
    load = Profile([0.5, 0.5], [0.0, 5.0])
    run = simulate(d, Course(Profile([0.0, 0.3], [0.0, 60.0]), 540.0, load), 1.2)
    assert run.trace.speed[-1] == pytest.approx(60.0, rel=2e-3)
    assert run.trace.torque[-1] == pytest.approx(5.0, rel=1e-2)


def test_anti_windup():
    """After 0.7 s at the current limit, the speed overshoots by at most a few percent."""
    d = drive(J=0.15)
    run = simulate(d, Course(Profile([0.0, 0.0], [0.0, 100.0]), 540.0), 1.5)
    assert any(event.what == "current limit met" for event in run.events)
    assert 99.0 < run.trace.speed.max() < 105.0


# ---- bad input -------------------------------------------------------------------------------


def test_unstable_gains_are_refused():
    with pytest.raises(ModelError, match=r"current_bandwidth = 8000 rad/s is unstable .* poles up"):
        simulate(drive(current_bandwidth=8000.0), Course(10.0, 540.0), 0.1)
    with pytest.raises(ModelError, match=r"speed_bandwidth .* must be positive and below"):
        simulate(drive(speed_bandwidth=1e4), Course(10.0, 540.0), 0.1)


def test_the_spectral_radius_separates_stable_from_unstable():
    """The loop is stable with a low bandwidth and unstable with a high one."""
    radius = {}
    for bandwidth in (1000.0, 2000.0, 4000.0, 6000.0):
        control = drive(current_bandwidth=bandwidth).control
        A = control.current_loop(float(control.motor.L_d))
        radius[bandwidth] = np.abs(np.linalg.eigvals(A)).max()
    assert radius[1000.0] < 1 < radius[6000.0]


def test_a_load_beyond_the_current_limit_is_refused():
    with pytest.raises(ModelError, match=r"a load of 50 N m cannot be held: .* torque is 22"):
        simulate(drive(), Course(10.0, 540.0, load=50.0), 0.1)


def test_impossible_values_are_refused():
    with pytest.raises(ModelError, match="J must be positive, got 0"):
        Mechanics(0.0)
    with pytest.raises(ModelError, match="both J_load and stiffness"):
        Mechanics(0.01, stiffness=10.0)
    with pytest.raises(ModelError, match="dead_time must be zero or positive, got -1e-06"):
        Inverter(dead_time=-1e-6)
    with pytest.raises(ModelError, match="switching must be a number of intervals"):
        Inverter(switching=2.5)
    with pytest.raises(ModelError, match="n_p must be a whole number"):
        Motor(1.0, 1e-3, 1e-3, 0.1, 2.5)
    with pytest.raises(ModelError, match="R_s must be positive"):
        Motor(-1.0, 1e-3, 1e-3, 0.1, 2)
    with pytest.raises(ModelError, match=r"offset must be a pair"):
        Sensors(offset=0.1)
    with pytest.raises(ModelError, match="noise must be zero or positive"):
        Sensors(noise=-1.0)
    with pytest.raises(ModelError, match=r"course.speed must be a number or a Profile"):
        simulate(drive(), Course([0.0, 100.0], 540.0), 0.1)
    with pytest.raises(ModelError, match="duration must be a number of seconds"):
        simulate(drive(), Course(10.0, 540.0), float("nan"))
    stiff = Mechanics(1e-3, J_load=1e-3, stiffness=1e12)
    with pytest.raises(ModelError, match=r"stiffness is .* steps per sample of 0.000125 s; leave"):
        simulate(replace(drive(), plant=Plant(MACHINES["pmsm-2kw2"], stiff)), Course(1.0, 540.0), 1)
    compiled = LeastSquaresObserver.for_machine(example("pmsm-2kw2"), sample_time=H)
    with pytest.raises(
        ModelError, match=r"drive.observer is a LeastSquaresObserver; create it with"
    ):
        simulate(replace(drive(), observer=compiled), Course(10.0, 540.0), 0.1)
    with pytest.raises(ModelError, match=r"drive.sensorless needs a drive.observer"):
        simulate(replace(drive(), sensorless=Sensorless(5.0, 40.0, 80.0)), Course(1.0, 540.0), 0.1)
    other = LeastSquaresObserver.for_machine(example("pmsm-2kw2"), sample_time=1e-3)
    slow = replace(drive(), observer=LoopObserver.of(other))
    with pytest.raises(ModelError, match=r"the observer's sample time is 0.001 s, but the dr"):
        simulate(slow, Course(1.0, 540.0), 0.1)
    with pytest.raises(ModelError, match="psi_f is missing"):
        Motor.of(SurfacePMSM(R_s=1.0, L_s=1e-3, n_p=4))
    with pytest.raises(MachineError, match="maglev-2dof: the simulation of drives is for machines"):
        Motor.of(example("maglev-knospe"))
    with pytest.raises(ModelError, match="dc_link must be positive"):
        simulate(drive(), Course(10.0, 0.0), 0.1)
    with pytest.raises(ModelError, match="less than two samples"):
        simulate(drive(), Course(10.0, 540.0), 1e-4)


def test_overcurrent_trips_and_is_reported():
    """The gains are those for seventy times the true inductance."""
    d = drive()
    small = Motor(0.1, 5e-4, 5e-4, 0.545, 3)
    d = replace(d, plant=Plant(small, d.plant.mechanics))
    run = simulate(d, Course(Profile([0.0, 0.0], [0.0, 100.0]), 540.0), 0.3)
    trips = [event for event in run.events if event.what == "overcurrent trip"]
    assert trips
    at = round(trips[0].at / H)
    assert np.abs(run.trace.current[at]) >= 3 * 9.0
    assert not run.trace.tripped[:at].any()
    assert (run.trace.voltage[at + 2 :] == 0).all()


def test_a_state_that_is_not_finite_raises():
    d = drive()
    # An array of NumPy has a strict type: JAX then uses the compiled simulation of other tests.
    nan = jnp.asarray(np.array(np.nan))
    broken = eqx.tree_at(lambda d: d.plant.mechanics.viscous, d, nan)
    with pytest.raises(ModelError, match=r"not finite after t = "):
        simulate(broken, Course(10.0, 540.0), 0.1)
    with pytest.raises(ModelError, match=r"lane 1 is not finite at the end"):
        simulate_batch([d, broken], [Course(10.0, 540.0)] * 2, 0.1, [0, 1], lambda row: row.speed)


# ---- records and batches ---------------------------------------------------------------------


def test_a_record_satisfies_the_voltage_equation():
    """Row k's voltage acts from row k to k + 1: Δλ = ∫ (u - R i) dt over every interval."""
    motor = MACHINES["pmsm-2kw2"]
    run = simulate(drive(), Course(Profile([0.0, 0.2], [0.0, 50.0]), 540.0, start_speed=0.0), 0.3)
    record, trace = run.record(), run.trace
    u = record.interval_voltage()[1:]
    step = np.diff(trace.flux)
    drop = float(motor.R_s) * (trace.current[1:] + trace.current[:-1]) / 2
    residual = step - H * (u[:, 0] + 1j * u[:, 1] - drop)
    assert np.abs(residual).max() < 1e-4 * float(motor.psi_f)
    assert np.abs(np.diff(trace.flux)).max() > 1e-2 * float(motor.psi_f)


def test_the_winding_warms_within_a_record():
    motor = MACHINES["pmsm-2kw2"]
    heat = Profile([0.0, 0.3], [1.0, 1.5])
    course = Course(Profile([0.0, 0.2], [0.0, 50.0]), 540.0, Profile([0.1], [10.0]), heat=heat)
    run = simulate(drive(), course, 0.3)
    u, trace = run.record().interval_voltage()[1:], run.trace
    i = (trace.current[1:] + trace.current[:-1]) / 2
    resistance = float(motor.R_s) * (1 + 0.5 * run.t[:-1] / 0.3)
    residual = np.diff(trace.flux) - H * (u[:, 0] + 1j * u[:, 1] - resistance * i)
    assert np.abs(residual).max() < 2e-4 * float(motor.psi_f)
    cold = residual - H * (resistance - float(motor.R_s)) * i
    assert np.abs(cold).max() > 1e-3 * float(motor.psi_f)


@pytest.mark.slow
def test_a_batch_agrees_with_single_runs():
    d = drive(sensors=Sensors(noise=0.05))
    courses = [
        Course(Profile([0.0, 0.1], [0.0, 30.0]), 540.0, theta_e=1.0),
        Course(Profile([0.0, 0.1, 0.15], [0.0, 50.0, -20.0]), 500.0, load=2.0),
        Course(20.0, 540.0),
    ]

    def keep(row):
        return row.speed, row.measured_current

    speed, current = simulate_batch([d] * 3, courses, 0.2, [4, 5, 6], keep)
    assert speed.shape == (3, 1600)
    for k, course in enumerate(courses):
        single = simulate(d, course, 0.2, seed=4 + k).trace
        assert np.allclose(speed[k], single.speed, atol=1e-9)
        assert np.allclose(current[k], single.measured_current, atol=1e-9)


def test_a_batch_of_different_drives_is_refused():
    a = drive()
    b = replace(a, plant=Plant(a.plant.motor, Mechanics(0.01, J_load=0.01, stiffness=100.0)))
    with pytest.raises(ModelError, match="drives with the same components"):
        simulate_batch([a, b], [Course(1.0, 540.0)] * 2, 0.1, [0, 1], lambda row: row.speed)
    with pytest.raises(ModelError, match="as many drives as courses"):
        simulate_batch([a], [Course(1.0, 540.0)] * 2, 0.1, [0, 1], lambda row: row.speed)


def test_turn_is_the_complex_exponential():
    assert complex(turn(jnp.asarray(np.pi / 3))) == pytest.approx(np.exp(1j * np.pi / 3))
