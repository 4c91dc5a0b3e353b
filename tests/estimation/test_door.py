"""The public functions: a log gives the same numbers in every form; misuse raises clear errors."""

import json
from functools import cache

import numpy as np
import polars as pl
import pytest

import fluxobs
from fluxobs import FluxobsError, MachineError, ObserverError, RecordError, UsageError
from fluxobs.simulation.closed_form.demo import LOG
from support.records import SERVO, steady

H = 1e-4


@cache
def signals():
    """Return voltage, current and angle as logged: the voltage of row k acts from k to k + 1."""
    samples = steady(SERVO, H, 500.0, 2000, 6j, 0.1 + 0.05j, 0.2, noise=0.02)
    voltage = np.concatenate([samples.voltage[1:], np.full((1, 2), np.nan)])
    return voltage, samples.current, samples.theta


def phases(vectors):
    """Return the phases of αβ vectors, plus a zero sequence that must have no effect."""
    turn = np.exp(-2j * np.pi / 3 * np.arange(3))
    return ((vectors @ [1, 1j])[:, None] * turn).real + 0.7


def channels(**more):
    u, i, _ = signals()
    names = ("u_alpha", "u_beta", "i_alpha", "i_beta")
    return dict(zip(names, (*u.T, *i.T), strict=True)) | more


def sources(folder):
    """Return one log in every form, with the options of each form."""
    u, i, _ = signals()
    names = ("u_a", "u_b", "u_c", "i_a", "i_b", "i_c")
    three = dict(zip(names, (*phases(u).T, *phases(i).T), strict=True))
    table = pl.DataFrame({"t": H * np.arange(len(u)), **channels()})
    table.with_columns(pl.all().fill_nan(None)).write_csv(folder / "log.csv")
    table.write_parquet(folder / "log.parquet")
    np.savez(folder / "log.npz", **channels())
    time = {"sample_time": H}
    return {
        "csv": (folder / "log.csv", {}),
        "parquet": (str(folder / "log.parquet"), {}),
        "npz": (folder / "log.npz", time),
        "opened": (fluxobs.read_log(folder / "log.csv"), {}),
        "record": (fluxobs.Record(H, u, i), {}),
        "mapping": (channels(), time),
        "frame": (table, {}),
        "pair": ((u, i), time),
        "complex": ((u @ [1, 1j], i @ [1, 1j]), time),
        "three phases": ((phases(u), phases(i)), time),
        "mixed": ((u, phases(i)), time),
        "abc": (three, time | {"frame": "abc"}),
    }


def test_every_form_of_a_log_gives_the_same_numbers(tmp_path):
    expected = None
    for name, (source, options) in sources(tmp_path).items():
        # The test is about reading; the causal estimate is the quickest.
        estimates = fluxobs.estimate(source, SERVO, causal=True, **options).estimates
        expected = estimates if expected is None else expected
        assert estimates.columns == expected.columns, name
        exact = name not in ("three phases", "mixed", "abc")  # the Clarke transform rounds
        for column in estimates.columns:
            actual, reference = estimates[column].to_numpy(), expected[column].to_numpy()
            if exact or column == "valid":
                np.testing.assert_array_equal(actual, reference, err_msg=f"{name}, {column}")
            else:
                np.testing.assert_allclose(
                    actual, reference, rtol=1e-9, atol=1e-9, err_msg=f"{name}, {column}"
                )


def test_the_lag_of_a_record_and_of_arrays_is_that_of_a_log():
    u, i, _ = signals()
    earlier = np.concatenate([np.full((1, 2), np.nan), u[:-1]])
    from_record = fluxobs.estimate(fluxobs.Record(H, earlier, i, lag=1), SERVO, causal=True)
    from_arrays = fluxobs.estimate((earlier, i), SERVO, sample_time=H, lag=1, causal=True)
    assert from_record.estimates.equals(from_arrays.estimates, null_equal=True)
    unshifted = fluxobs.estimate((u, i), SERVO, sample_time=H, lag=0, causal=True)
    # Only the first row's interval differs.
    assert np.abs(from_record["flux_alpha"] - unshifted["flux_alpha"])[100:].max() < 1e-9


def test_a_truth_scores():
    u, i, theta = signals()
    result = fluxobs.estimate(fluxobs.Record(H, u, i, lag=0, theta_e=theta), "servo-400w")
    assert result.statistics.scored == result.statistics.valid > 1000
    assert result.statistics.rms_error < np.radians(0.2)
    mechanical = fluxobs.estimate(
        channels(shaft=np.unwrap(theta) / SERVO.n_p),
        SERVO,
        sample_time=H,
        lag=0,
        truth={"theta_mech": "shaft"},
    )
    np.testing.assert_allclose(mechanical["theta_e_error"], result["theta_e_error"], atol=1e-9)


def test_record_toml_and_options_have_the_same_names(tmp_path):
    """A field of the record file equals the option of the same name; options override it."""
    fields = {
        "sample_time": H,
        "lag": -1.0,
        "columns": {"u_alpha": "ua"},
        "scale": {"i_alpha": 2.0},
        "offset": {"i_beta": 0.5},
        "start": 0.02,
        "stop": 0.15,
    }
    text = "\n".join(
        f"{name} = {json.dumps(value)}"
        if not isinstance(value, dict)
        else f"[{name}]\n" + "\n".join(f"{k} = {json.dumps(v)}" for k, v in value.items())
        for name, value in sorted(fields.items(), key=lambda item: isinstance(item[1], dict))
    )
    (tmp_path / "record.toml").write_text(text)
    log = channels()
    log["ua"] = log.pop("u_alpha")
    by_file = fluxobs.read_log(log, record=tmp_path / "record.toml")
    by_name = fluxobs.read_log(log, **fields)
    assert by_file.layout == by_name.layout
    assert len(by_file) == 1301
    later = fluxobs.read_log(log, record=tmp_path / "record.toml", lag=0, scale={"i_beta": 3.0})
    assert later.layout.lag == 0
    assert later.layout.scale == {"i_alpha": 2.0, "i_beta": 3.0}


def test_result_shows_writes_and_draws(tmp_path):
    result = fluxobs.estimate(LOG, "servo-400w", truth={"theta_e": "theta_e"}, stop=0.3)
    assert str(result).startswith(result.summary)
    assert all(warning in str(result) for warning in result.warnings)
    assert "demo_log.csv" in repr(result)
    result.write(tmp_path / "estimates.parquet")
    assert pl.read_parquet(tmp_path / "estimates.parquet").equals(result.estimates)
    result.write(tmp_path / "report.svg")
    assert "</svg>" in (tmp_path / "report.svg").read_text()
    assert len(result.plot().axes) == 9
    with pytest.raises(FluxobsError, match="did you mean 'theta_e'"):
        result["theta"]
    with pytest.raises(FluxobsError, match="is written to"):
        result.write(tmp_path / "estimates.xlsx")


def test_streaming_to_a_file_is_the_same(tmp_path):
    in_memory = fluxobs.estimate(LOG, "servo-400w", unknowns="drift,resistance", stop=0.5)
    progress = []
    streamed = fluxobs.estimate(
        LOG,
        "servo-400w",
        unknowns=("drift", "resistance"),
        stop=0.5,
        out=tmp_path / "out.parquet",
        progress=lambda done, total: progress.append((done, total)),
    )
    assert streamed.path == tmp_path / "out.parquet"
    assert streamed.estimates.equals(in_memory.estimates)
    assert streamed.summary == in_memory.summary
    assert progress[-1] == (2 * 2501, 2 * 2501)  # both passes


def test_the_other_public_functions(tmp_path):
    identified = fluxobs.identify(LOG, "servo-400w")
    assert identified.machine.inverter_voltage == pytest.approx(0.15, abs=0.02)
    identified.write(tmp_path / "found.toml")
    assert fluxobs.read_machine(tmp_path / "found.toml") == identified.machine
    with pytest.raises(FluxobsError, match="exists"):
        identified.write(tmp_path / "found.toml")
    assert str(identified) == "\n".join(identified.lines())
    assert fluxobs.check(LOG, "servo-400w").sound
    assert fluxobs.example("servo-400w") == SERVO
    assert len(fluxobs.demo_log()) == 10000
    for name in fluxobs.__all__:
        assert getattr(fluxobs, name) is not None


LEVER = fluxobs.example("maglev-knospe")


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (
            lambda: fluxobs.Record(H, np.zeros((5, 4)), np.zeros((5, 4))),
            RecordError,
            r"\(rows, 2\)",
        ),
        (lambda: fluxobs.Record(H, ["x"], ["y"]), RecordError, "must hold numbers"),
        (lambda: fluxobs.Record(0.0, *signals()[:2]), RecordError, "sample_time must be positive"),
        (lambda: fluxobs.SurfacePMSM(R_s=-1.0, L_s=1e-3, n_p=2), MachineError, "R_s must be"),
        (lambda: fluxobs.SurfacePMSM(R=1.0, L_s=1e-3, n_p=2), MachineError, "did you mean 'R_s'"),
        (
            lambda: fluxobs.LeastSquaresObserver.for_machine("servo-400w", sample_time=H),
            MachineError,
            "read_machine",
        ),
        (
            lambda: fluxobs.AdaptiveObserver.for_machine(LEVER, sample_time=H),
            MachineError,
            "machines that turn",
        ),
        (
            lambda: fluxobs.LeastSquaresObserver.for_machine(SERVO, sample_time="fast"),
            UsageError,
            "sample_time must be a number",
        ),
        (
            lambda: fluxobs.LeastSquaresObserver.for_machine(SERVO, sample_time=H, memory=H),
            ObserverError,
            "ten samples",
        ),
        (lambda: fluxobs.estimate(signals()[:2], SERVO), UsageError, "sample_time is missing"),
        (lambda: fluxobs.estimate(3, SERVO), RecordError, "a log is a file"),
        (lambda: fluxobs.estimate(channels(), SERVO), RecordError, "sample_time|sample time"),
        (
            lambda: fluxobs.estimate(channels(), SERVO, sample_time=H, lagg=1),
            RecordError,
            "did you mean 'lag'",
        ),
        (lambda: fluxobs.estimate(fluxobs.demo_log(), SERVO, lag=1), UsageError, "already open"),
        (lambda: fluxobs.estimate(fluxobs.demo_log(), LEVER), RecordError, "does not fit kind"),
        (lambda: fluxobs.estimate(fluxobs.demo_log(), "servo"), MachineError, "servo-400w"),
        (lambda: fluxobs.estimate(fluxobs.demo_log(), None), MachineError, "expected a machine"),
        (
            lambda: fluxobs.estimate(LOG, SERVO, truth={"position": "theta_e"}),
            RecordError,
            "truth position",
        ),
        (
            lambda: fluxobs.estimate(LOG, SERVO, unknowns="resistence"),
            FluxobsError,
            "did you mean 'resistance'",
        ),
        (
            lambda: fluxobs.estimate(LOG, SERVO, memory="long"),
            UsageError,
            "memory must be a number",
        ),
        (lambda: fluxobs.identify(LOG, SERVO, free="R"), FluxobsError, "did you mean 'R_s'"),
        (lambda: fluxobs.identify(LOG, LEVER), MachineError, "machines that turn"),
        (lambda: fluxobs.compare("nois"), FluxobsError, "neither a file nor a scenario"),
        (lambda: fluxobs.compare(fluxobs.demo_log()), FluxobsError, "a log needs a machine"),
        (
            lambda: fluxobs.export(LEVER, H, "never", unknowns="drift"),
            FluxobsError,
            "machines that turn",
        ),
        (lambda: fluxobs.QuadraticConstraint([[1]], [[1, 2]], [[1]]), FluxobsError, "shape"),
    ],
)
def test_misuse_is_reported_with_a_remedy(call, error, message):
    with pytest.raises(error, match=message) as caught:
        call()
    assert isinstance(caught.value, FluxobsError)
