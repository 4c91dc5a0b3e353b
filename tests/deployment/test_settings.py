"""Invalid settings are refused, and the message gives the nearest valid value."""

import pytest

import fluxobs
from fluxobs import FluxobsError
from support.records import MACHINES

ADAPTIVE = ("drift", "resistance", "inverter")


@pytest.mark.parametrize(
    ("options", "fragments"),
    [
        ({"sample_time": 0.0}, ["sample time 0 s", "1e-4 s"]),
        ({"sample_time": -1e-4}, ["sample time -0.0001 s", "0.0001 s would work"]),
        ({"sample_time": float("nan")}, ["sample time nan"]),
        ({"sample_time": 20000.0}, ["20000 Hz is 5e-05 s"]),
        ({"sample_time": 0.05}, ["0.05 ms is 5e-05 s"]),
        ({"sample_time": 50.0}, ["50 µs is 5e-05 s", "50 kHz is 2e-05 s"]),
        ({"sample_time": 1e9}, ["in seconds"]),
        ({"current_noise": 100.0}, ["never becomes valid", "current noise 100 A"]),
        ({"memory": 5e-4}, ["memory 0.0005 s", "ten steps", "0.001 s"]),
        ({"sample_time": 0.01}, ["memory 0.03 s", "0.1 s"]),
        ({"update_every": 0}, ["update_every 0", "at least 1"]),
        ({"update_every": 50}, ["memory 0.03 s", "step every 0.005 s", "0.05 s"]),
        ({"memory": 1.0}, ["memory 1 s", "4000 steps", "0.4 s", "update_every 3"]),
        ({"unknowns": ("drift", "current-bias")}, ["estimate the drift", "use drift"]),
        ({"unknowns": ("current-bias",)}, ["estimate the drift", "use drift"]),
        ({"unknowns": ("resistance",)}, ["without the drift", "drift,resistance"]),
        ({"unknowns": ADAPTIVE, "priors": {"resistance": 1e6}}, ["resistance_std", "SI units"]),
        ({"unknowns": ADAPTIVE, "priors": {"R": 1.0}}, ["'R'", "resistance"]),
        (
            {"unknowns": "drift", "priors": {"psi_f": 0.001}},
            ["requires resistance or inverter", "among the unknowns"],
        ),
        ({"unknowns": ("drft",)}, ["unknown 'drft'", "did you mean 'drift'"]),
        ({"unknowns": ()}, ["drift suffices"]),
        ({"current_noise": 0.0}, ["current_noise must be positive"]),
        ({"drift_prior": float("inf")}, ["drift_prior must be positive and finite"]),
        ({"prefix": "2nd motor"}, ["'2nd motor'", "'motor_2nd_motor'"]),
        ({"prefix": "fo"}, ["'fo'", "'motor'"]),
    ],
)
def test_messages_give_the_nearest_valid_setting(tmp_path, options, fragments):
    settings = {"sample_time": 1e-4, "out": tmp_path / "motor"} | options
    with pytest.raises(FluxobsError) as error:
        fluxobs.export(MACHINES["servo-400w"], **settings)
    for fragment in fragments:
        assert fragment in str(error.value)
    assert not list(tmp_path.iterdir())


def test_machines_that_cannot_be_exported(tmp_path):
    with pytest.raises(FluxobsError, match="machines that turn"):
        fluxobs.export(
            fluxobs.read_machine("maglev-knospe"), 1e-4, tmp_path / "x", unknowns="drift"
        )
    bare = MACHINES["servo-400w"].model_copy(update={"psi_f": None, "rated_current": None})
    with pytest.raises(FluxobsError, match="lacks psi_f and rated_current"):
        fluxobs.export(bare, 1e-4, tmp_path / "x", unknowns="drift")
    wrong = MACHINES["servo-400w"].model_copy(update={"psi_f": 1e-9})
    with pytest.raises(FluxobsError, match="units"):
        fluxobs.export(wrong, 1e-4, tmp_path / "x", unknowns="drift")
    synrm = fluxobs.read_machine("synrm-6kw7")
    with pytest.raises(FluxobsError, match="estimate the drift"):
        fluxobs.export(synrm, 1e-4, tmp_path / "x", unknowns=("drift", "current-bias"))
    dropping = MACHINES["servo-400w"].model_copy(update={"inverter_voltage": 0.5})
    with pytest.raises(FluxobsError, match="with unknowns drift,inverter"):
        fluxobs.export(dropping, 1e-4, tmp_path / "x", unknowns="drift")
