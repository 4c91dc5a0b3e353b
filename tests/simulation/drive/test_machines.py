"""Plants with a cage or a flux map, and the drives of these plants."""

from __future__ import annotations

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fluxobs import LeastSquaresObserver, ModelError
from fluxobs.machines import example
from fluxobs.simulation.drive import (
    Course,
    Mechanics,
    Plant,
    Profile,
    encoder_drive,
    rating,
    sensorless_drive,
    simulate,
)
from fluxobs.simulation.drive.motor import CageMotor, MappedMotor, Motor
from fluxobs.simulation.drive.sensorless import RUNNING
from support.records import wrapped_degrees

H = 1.25e-4
CAGE, RATED = example("induction-2kw2"), rating("induction-2kw2")
BASE = RATED.speed_e / CAGE.n_p
MOTORS = {
    "cage": Motor.of(CAGE),
    "saturating cage": CageMotor(3.7, 2.1, 0.021, 0.224, 0.9, 2, saturation=0.5),
    "interior, measured map": Motor.of(example("ipm-5kw6")),
    "reluctance, saturated": Motor.of(example("synrm-6kw7-saturated")),
}


def course(speed, load=((0.0, 0.0),)):
    """Return a course from speed and load over time, as shares of the rated values."""
    speeds, loads = np.array(speed), np.array(load)
    return Course(
        Profile(speeds[:, 0], BASE * speeds[:, 1]),
        RATED.dc_link,
        Profile(loads[:, 0], RATED.torque * loads[:, 1]),
    )


def errors(run):
    return wrapped_degrees(np.asarray(run.trace.reading.theta_e - run.trace.theta_e))


def test_each_machine_has_its_motor():
    assert isinstance(MOTORS["cage"], CageMotor)
    assert isinstance(MOTORS["interior, measured map"], MappedMotor)
    assert type(Motor.of(example("pmsm-2kw2"))) is Motor


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.slow) if "," in name else name for name in MOTORS],
)
def test_power_balance(name):
    """Electrical input = copper loss + friction + cage loss + stored energy."""
    motor = MOTORS[name]
    plant = Plant(motor, Mechanics(0.01, viscous=0.02))
    h, n = 2e-5, 4000
    t = h * np.arange(n)
    size = 60.0 if isinstance(motor, CageMotor) else 40.0
    voltage = size * np.exp(1j * (60 * t + 200 * t**2))

    def powers(state, u):
        i = plant.current(state)
        rotor = 0.0
        if isinstance(motor, CageMotor):
            current = i - motor.magnetizing(jnp.abs(state.rotor)) * state.rotor
            rotor = 1.5 * motor.R_R * jnp.abs(current) ** 2
        losses = 1.5 * motor.R_s * jnp.abs(i) ** 2 + rotor
        return jnp.stack(
            [
                1.5 * (u * jnp.conj(i)).real,
                losses + plant.mechanics.resisting(state.speed) * state.speed,
            ]
        )

    def body(state, u):
        half = plant.advance(state, u, jnp.zeros(()), jnp.asarray(h / 2), 1)
        after = plant.advance(half, u, jnp.zeros(()), jnp.asarray(h / 2), 1)
        work = powers(state, u) + 4 * powers(half, u) + powers(after, u)  # Simpson
        return after, h / 6 * work

    start = plant.standstill(0.4, 20.0)
    end, work = jax.jit(partial(jax.lax.scan, body))(start, jnp.asarray(voltage))
    supplied, lost = np.asarray(work).sum(axis=0)

    def stored(state):
        magnetic = motor.field_energy(plant.current(state), state.rotor)
        return float(magnetic + plant.mechanics.J * state.speed**2 / 2)

    increase = stored(end) - stored(start)
    # Splines are not exactly reciprocal: their energy depends slightly on the path.
    exact = isinstance(motor, CageMotor)
    assert abs(supplied) > 1
    assert supplied - lost == pytest.approx(increase, abs=(1e-7 if exact else 5e-3) * abs(supplied))


@pytest.mark.parametrize("name", ["interior, measured map", "reluctance, saturated"])
def test_the_current_inverts_the_flux_of_a_map(name):
    motor = MOTORS[name]
    rng = np.random.default_rng(1)
    i = rng.uniform(-12, 2, 40) + 1j * rng.uniform(-15, 15, 40)
    rotor = np.exp(1j * rng.uniform(-3, 3, 40))
    flux = jax.vmap(motor.flux)(jnp.asarray(i * rotor), jnp.asarray(rotor))
    current = jax.vmap(motor.current)(flux, jnp.asarray(rotor))
    np.testing.assert_allclose(np.asarray(current), i * rotor, atol=1e-9)


@pytest.mark.parametrize("name", ["ipm-2kw2", "ipm-5kw6"])
def test_harmonics_of_the_magnet_flux(name):
    motor = Motor.of(example(name))
    psi = float(motor.psi_f)
    with_harmonics = eqx.tree_at(
        lambda m: [m.fifth, m.seventh], motor, [jnp.asarray(0.03), jnp.asarray(-0.02)]
    )
    current = jnp.asarray(2.0 - 3.0j)
    for theta in np.linspace(-3, 3, 7):
        rotor = jnp.exp(1j * theta)
        flux = with_harmonics.flux(current, rotor)
        # In stator coordinates the 5th harmonic turns backwards, five times as fast as the rotor.
        harmonics = psi * (0.03 * np.exp(-5j * theta) - 0.02 * np.exp(7j * theta))
        assert complex(flux - motor.flux(current, rotor)) == pytest.approx(harmonics, abs=1e-9)
        assert complex(with_harmonics.current(flux, rotor)) == pytest.approx(
            complex(current), abs=1e-6
        )


def test_the_iron_loss_takes_its_power_from_the_terminals():
    motor = Motor(0.3, 2e-3, 2e-3, 0.1, 3, iron_loss=0.02)
    plant = Plant(motor, Mechanics(0.01))
    speed = 200.0
    state = plant.standstill(0.4, speed)
    iron = complex(plant.terminal_current(state) - plant.current(state))
    emf = 1j * 3 * speed * complex(state.flux)
    assert iron == pytest.approx(0.02 * emf)  # in phase with the EMF: only active power
    # The winding resistance carries this current too.
    rate = plant.rate(state, jnp.asarray(0j), jnp.asarray(0.0))
    assert complex(rate.flux) == pytest.approx(-0.3 * iron)


def test_a_cage_in_steady_state():
    """With locked rotor and impressed current, flux and torque equal the equivalent circuit's."""
    motor = MOTORS["cage"]
    plant = Plant(motor, Mechanics(1e9))
    slip = 15.0
    i = 5.0 + 0j
    psi = motor.R_R * i / (motor.R_R / motor.L_M + 1j * slip)
    flux = motor.L_d * i + psi
    torque = float(motor.torque(flux, i))
    square = abs(complex(psi)) ** 2
    assert torque == pytest.approx(1.5 * 2 * square * slip / float(motor.R_R), rel=1e-6)
    state = plant.standstill()._replace(flux=jnp.asarray(flux), rotor=jnp.asarray(psi))
    u = motor.R_s * i + 1j * slip * flux
    rate = plant.rate(state, jnp.asarray(u), jnp.zeros(()))
    assert complex(rate.rotor) == pytest.approx(1j * slip * complex(psi), rel=1e-6)
    assert float(motor.slip(jnp.asarray((i * np.conj(psi)).imag / abs(psi)), abs(psi))) == (
        pytest.approx(slip, rel=1e-6)
    )


def test_main_flux_saturation_adds_no_position_error():
    """The rotor flux is constant, so L_M has no effect."""
    rms_errors = []
    for motor in (MOTORS["cage"], MOTORS["saturating cage"]):
        drive = encoder_drive(CAGE, RATED, noise=0.02)
        plant = Plant(motor, drive.plant.mechanics)
        drive = drive.__class__(plant, drive.inverter, drive.sensors, drive.control)
        # This duration has the compiled length of the test of field orientation.
        run = simulate(drive, course([(0.3, 0.0), (0.6, 0.8)], [(0.9, 0.0), (0.9, 0.8)]), 1.6)
        record = run.record()
        observer = LeastSquaresObserver.for_machine(CAGE, sample_time=H)
        estimate = observer.run(record.interval_voltage(), record.current)
        error = wrapped_degrees(estimate.theta_e - run.trace.theta_e)[6400:]
        rms_errors.append(np.sqrt(np.mean(error**2)))
    assert max(rms_errors) < 0.05


# ---- drives ----------------------------------------------------------------------------------


def test_field_orientation_with_an_encoder():
    speed = [(0.3, 0.0), (0.8, 1.0), (1.2, 1.0), (1.6, 1.5)]
    run = simulate(encoder_drive(CAGE, RATED), course(speed, [(1.0, 0.0), (1.0, 0.5)]), 2.2)
    t, trace = run.t, run.trace
    psi = np.abs(trace.flux - CAGE.L_sigma * trace.current)
    assert psi[t > 0.25][0] == pytest.approx(0.9, rel=0.03)
    assert psi[(t > 0.5) & (t < 0.7)] == pytest.approx(0.9, rel=0.01)
    assert 0.4 < psi[-1] < 0.6  # weakened
    assert trace.speed[-1] == pytest.approx(1.5 * BASE, rel=0.01)
    assert trace.torque[-100:].mean() == pytest.approx(0.5 * RATED.torque, rel=0.05)


@pytest.mark.slow
def test_sensorless_from_standstill_through_a_loaded_reversal():
    drive = sensorless_drive(CAGE, RATED, offset=(0.13, 0.18), noise=0.02)
    speed = [(0, 0), (0.2, 0.1), (0.6, 0.1), (1.0, 0.8), (1.6, 0.8), (2.6, -0.8), (3.0, -0.8)]
    run = simulate(drive, course(speed, [(1.3, 0.0), (1.3, 1.0)]), 3.0)
    t, trace = run.t, run.trace
    running = t > 0.8
    assert (trace.mode[running] == RUNNING).all()
    assert not any("lost" in event.what for event in run.events)
    assert abs(trace.speed[-1] + 0.8 * BASE) < 0.01 * BASE
    error = errors(run)[running]
    assert np.sqrt(np.mean(error**2)) < 0.4


@pytest.mark.slow
@pytest.mark.parametrize("wrong", [{}, {"R_R": 1.2}, {"R_R": 0.8}, {"R_s": 1.2}, {"R_s": 0.8}])
def test_sensorless_with_wrong_resistances_and_offsets(wrong):
    believed = CAGE
    for name, factor in wrong.items():
        believed = believed.scaled([name], factor)
    drive = sensorless_drive(CAGE, RATED, believed=believed, offset=(0.13, 0.18), noise=0.02)
    speed = [(0, 0), (0.2, 0.1), (0.6, 0.1), (1.2, 1.0), (1.8, 1.5)]
    run = simulate(drive, course(speed, [(2.0, 0.0), (2.0, 0.5)]), 2.6)
    t, trace = run.t, run.trace
    assert (trace.mode[t > 1.0] == RUNNING).all()
    # A wrong R_R gives a wrong slip and speed; with a wrong R_s, the loop has little damping.
    limit = 0.15 if "R_s" in wrong else 0.03
    assert abs(trace.speed[-1] - 1.5 * BASE) < limit * BASE


@pytest.mark.slow
def test_a_drive_with_a_map_follows_its_reference():
    machine, rated = example("ipm-5kw6"), rating("ipm-5kw6")
    base = rated.speed_e / machine.n_p
    drive = encoder_drive(machine, rated, noise=0.02)
    load = Profile([0.6, 0.6], [0.0, 0.7 * rated.torque])
    run = simulate(drive, Course(Profile([0, 0.4], [0, 0.6 * base]), rated.dc_link, load), 1.2)
    assert run.trace.speed[-1] == pytest.approx(0.6 * base, rel=0.01)
    record = run.record()
    observer = LeastSquaresObserver.for_machine(machine, sample_time=float(drive.sample_time))
    estimate = observer.run(record.interval_voltage(), record.current)
    error = wrapped_degrees(estimate.theta_e - run.trace.theta_e)
    assert np.sqrt(np.mean(error[3200:] ** 2)) < 0.5
    assert np.abs(error[estimate.valid]).max() < 3.5


def test_a_machine_without_psi_f_is_refused():
    machine = example("pmsm-2kw2").with_values(psi_f=None)
    with pytest.raises(ModelError, match="psi_f is missing"):
        Motor.of(machine)
