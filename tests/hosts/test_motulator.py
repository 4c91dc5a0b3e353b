"""Comparison with motulator's observer in closed loop: start, load step, reversal and dead time."""

from math import pi

import numpy as np
import pytest

pytest.importorskip("motulator", reason="another Python: motulator needs 3.12 (make hosts)")

from motulator.common.model import Sensor
from motulator.drive import model
from motulator.drive.control import sm as control
from motulator.drive.control.sm import SynchronousMachinePars
from motulator_entrants import FluxObserver
from motulator_observer import machine_of, place

import fluxobs
from fluxobs import FluxobsError

#: Machines of motulator's examples: a 2.2 kW PMSM and a 6.7 kW reluctance machine.
PMSM = SynchronousMachinePars(n_p=3, R_s=3.6, L_d=0.036, L_q=0.051, psi_f=0.545)
SYNRM = SynchronousMachinePars(n_p=2, R_s=0.54, L_d=0.0415, L_q=0.0062, psi_f=0.0)
STEP = 125e-6
RATED_SPEED, LOAD = 2 * pi * 75 / 3, 14.0  # mechanical [rad/s], [Nm]


def speed_reference(t):
    """Run up in half a second, then reverse."""
    return float(np.interp(t, [0.1, 0.6, 2.0, 3.0], [0.0, 1.0, 1.0, -1.0])) * 0.6 * RATED_SPEED


def load(t):
    return LOAD * ((t > 1.0) and (t < 1.6))


def adapting(w_m):
    """PM-flux gain of motulator's example: from a fifth of the rated speed on."""
    return max(0.05 * (abs(w_m) - 0.2 * 2 * pi * 75), 0.0)


def simulate(
    par,
    with_fluxobs,
    dead_time=0.0,
    offset=0.0,
    psi_s_min=None,
    gains=None,
    record=None,
    **settings,
):
    """Return (time, error of the electrical angle [degrees], true and estimated speed, valid).

    `gains` are those of motulator's observer; voltages, currents and rotor axes go into
    `record`.
    """
    sensor = Sensor(offset=[offset, -offset / 2, 0.0], std=0.02, rng=np.random.default_rng(1))
    machine = model.SynchronousMachine(par, i_s_sensor=sensor)
    mechanics = model.MechanicalSystem(J=0.015)
    mechanics.set_external_load_torque(load)
    drive = model.Drive(machine, mechanics, model.VoltageSourceConverter(u_dc=540.0, t_d=dead_time))
    config = control.CurrentVectorControllerCfg(
        i_s_max=10.0, T_s=STEP, psi_s_min=psi_s_min, **(gains or {})
    )
    vector = control.CurrentVectorController(par, config)
    placed = place(vector, **settings) if with_fluxobs else None
    feedback, samples = vector.get_feedback, []

    def watched(*arguments):
        outputs = feedback(*arguments)
        turn = 360.0 if par.psi_f else 180.0  # without magnets, half a turn is ambiguous
        ahead = np.degrees(outputs.theta_m - par.n_p * mechanics.out.theta_M)
        error = (ahead + turn / 2) % turn - turn / 2
        valid = bool(placed.estimate.valid) if placed else True
        samples.append((error, mechanics.out.w_M, outputs.w_M, valid))
        if record is not None:
            turned = np.exp(1j * outputs.theta_c)
            record.append(
                (turned * outputs.u_s_zoh, turned * outputs.i_s, np.exp(1j * outputs.theta_m))
            )
        return outputs

    vector.get_feedback = watched
    speed = control.SpeedController(J=0.015, alpha_s=2 * pi * 4, tau_M_max=1.5 * LOAD)
    system = control.VectorControlSystem(vector, speed)
    system.set_speed_ref(speed_reference)
    model.Simulation(drive, system, show_progress=False).simulate(t_stop=3.5)
    error, true, estimated, valid = np.array(samples).T
    return STEP * np.arange(len(error)), error, true, estimated, valid > 0


ADAPTIVE = "drift,resistance,inverter"
#: Segments of the course [s].
SEGMENTS = {"run up": (0.1, 0.6), "load": (1.0, 1.6), "reversal": (2.0, 3.0), "end": (3.0, 3.5)}


def rms(t, error, segment):
    begin, end = SEGMENTS[segment]
    return np.sqrt(np.mean(error[(t > begin) & (t < end)] ** 2))


@pytest.mark.parametrize("gains", [{}, {"J": 0.015, "k_f": adapting}], ids=["default", "J, k_f"])
@pytest.mark.parametrize("dead_time", [0.0, 2e-6])
def test_a_pmsm_beside_motulators_own_observer(dead_time, gains):
    """Start from standstill, load step, reversal without load; offsets of 50 mA, and noise."""
    t, own, *_ = simulate(PMSM, False, dead_time, offset=0.05, gains=gains)
    _, ours, true, estimated, valid = simulate(
        PMSM, True, dead_time, offset=0.05, unknowns=ADAPTIVE
    )
    assert abs(true[-1] / (-0.6 * RATED_SPEED) - 1) < 0.01
    assert valid[(t > 0.7) & (t < 2.0)].all()
    assert valid[t > 3.0].all()
    for segment in ("load", "reversal", "end"):
        assert rms(t, ours, segment) < 0.5 * rms(t, own, segment), segment
        assert rms(t, ours, segment) < 1.0, segment
    assert np.abs(ours[valid]).max() < (10.0 if dead_time else 2.0)
    assert abs(estimated - true)[valid & (t > 0.7)].max() < 0.1 * RATED_SPEED


def test_a_reluctance_machine_with_dead_time():
    """motulator's observer loses the position at the reversal; fluxobs does not."""
    t, ours, true, _, valid = simulate(
        SYNRM, True, 2e-6, offset=0.05, psi_s_min=0.3, unknowns=ADAPTIVE
    )
    assert abs(true[-1] / (-0.6 * RATED_SPEED) - 1) < 0.01
    assert valid[(t > 0.8) & (t < 2.0)].mean() > 0.9
    assert rms(t, ours, "load") < 0.6
    assert rms(t, ours, "end") < 0.3


def test_the_inertia_of_the_simulated_drive():
    """motulator's drive has J = 0.015 kg m²; its own observer controls it."""
    record = []
    simulate(PMSM, False, offset=0.05, record=record)
    u, i, _ = np.array(record).T
    found = fluxobs.identify((u, i), machine_of(PMSM, 6.1), free="J", sample_time=STEP, lag=0)
    (J,) = found.parameters
    assert abs(J.value - 0.015) < 2 * J.std
    assert abs(J.value / 0.015 - 1) < 0.03


def test_an_observer_as_an_entrant_of_the_benchmark():
    """The entrant on a log of the drive has the angles of the observer that controlled it."""
    record = []
    simulate(PMSM, False, offset=0.05, record=record)
    u, i, own = np.array(record).T
    fields = {"kind": "interior-pmsm", "n_p": 3, "R_s": 3.6, "psi_f": 0.545}
    fields |= {"L_d": 0.036, "L_q": 0.051, "rated_current": 6.1}
    observer = FluxObserver(fields, STEP)
    ended = np.concatenate([[np.nan], u[:-1]])
    estimates = [
        observer.step([voltage.real, voltage.imag], [current.real, current.imag])
        for voltage, current in zip(ended, i, strict=True)
    ]
    theta, _, _, speed, torque = np.array(estimates).T
    later = STEP * np.arange(len(i)) > 0.7
    assert np.abs(np.angle(np.exp(1j * theta) / own))[later].max() < 1e-6
    loaded = (STEP * np.arange(len(i)) > 1.3) & (STEP * np.arange(len(i)) < 1.6)
    assert abs(np.mean(torque[loaded]) / LOAD - 1) < 0.05
    assert abs(np.mean(speed[loaded]) / (3 * 0.6 * RATED_SPEED) - 1) < 0.01


def test_machines_and_refused_controllers():
    assert isinstance(machine_of(SYNRM, 5.0), fluxobs.SynchronousReluctance)
    assert isinstance(machine_of(PMSM, 5.0), fluxobs.InteriorPMSM)
    same = SynchronousMachinePars(n_p=3, R_s=3.6, L_d=0.036, L_q=0.036, psi_f=0.545)
    assert isinstance(machine_of(same, 5.0), fluxobs.SurfacePMSM)
    with pytest.raises(FluxobsError, match="flux_map"):
        machine_of(object(), 5.0)
    config = control.CurrentVectorControllerCfg(i_s_max=10.0, sensorless=False)
    with pytest.raises(FluxobsError, match="sensorless"):
        place(control.CurrentVectorController(PMSM, config))
    vector = control.CurrentVectorController(PMSM, control.CurrentVectorControllerCfg(i_s_max=10.0))
    other = fluxobs.LeastSquaresObserver.for_machine(machine_of(PMSM, 5.0), sample_time=1e-4)
    with pytest.raises(FluxobsError, match=r"0\.0001 s, the controller every 0\.000125"):
        place(vector, observer=other)
