"""The result of an estimation: columns, files, pictures and texts."""

import sys
from types import SimpleNamespace

import numpy as np
import polars as pl
import pytest
from matplotlib.figure import Figure

import fluxobs
from fluxobs import FluxobsError, estimate
from fluxobs.estimation import learning
from fluxobs.estimation.columns import column_units
from fluxobs.machines import FluxPoints, as_machine
from fluxobs.observers import Estimate, SampleCounts, in_files
from fluxobs.observers.derived import derived_outputs
from fluxobs.smoothing.estimate import SmoothedEstimate
from support.cli import COLUMNS as PLAIN
from support.cli import fluxobs as command
from support.records import PMSM, SERVO, course, driven, log_columns, profile, steady

H, ROWS = 1e-4, 2000
SAMPLES = steady(SERVO, H, 500.0, ROWS, 6j, 0.15 - 0.1j, -0.1 + 0.05j, 0.02)
COLUMNS = log_columns(SAMPLES)
PORTS = ("alpha", "beta")
UNKNOWNS = ("drift", "resistance", "inverter")


@pytest.fixture(scope="module")
def plain():
    columns = COLUMNS | {"angle": SAMPLES.theta}
    return fluxobs.estimate(
        columns, SERVO, unknowns="drift", causal=True, truth={"theta_e": "angle"}
    )


@pytest.fixture(scope="module")
def adaptive():
    columns = log_columns(course(R_s=1.3 * PMSM.R_s, inverter=6.0, smoothing=0.2))
    return fluxobs.estimate(columns, PMSM, unknowns=UNKNOWNS, priors={"psi_f": 0.02})


def columns_of(estimate):
    *names, valid = [name for output in in_files(estimate) for name in output.columns(PORTS)]
    return [*names, *(output.name for output in derived_outputs(SERVO)), "quality", valid]


@pytest.mark.skipif(sys.platform != "linux", reason="file names are text there")
@pytest.mark.parametrize("name", ["out [1].parquet", "out [1].csv", "out\udce9.parquet"])
def test_estimates_in_a_file_of_any_name(tmp_path, name):
    result = fluxobs.estimate(COLUMNS, SERVO, unknowns="drift", causal=True, out=tmp_path / name)
    assert result.estimates.height == ROWS


def test_columns_are_the_listed_outputs(plain, adaptive):
    assert plain.estimates.columns == ["t", *columns_of(Estimate), "theta_e_error"]
    assert plain.estimates.columns[:-1] == PLAIN
    *names, valid = [
        name for output in in_files(SmoothedEstimate) for name in output.columns(PORTS)
    ]
    derived = [output.name for output in derived_outputs(PMSM)]
    assert adaptive.estimates.columns == ["t", *names, *derived, "torque_std", "quality", valid]
    assert plain.estimates.height == ROWS


def test_a_column_is_an_array(plain):
    assert plain["valid"].dtype == bool
    np.testing.assert_array_equal(plain["t"], COLUMNS["t"])
    np.testing.assert_array_equal(plain["flux_beta"], plain.estimates["flux_beta"].to_numpy())


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("theta", "no column 'theta'; did you mean 'theta_e'"),
        ("resistance", "no column 'resistance'"),
        ("xyz", "no column 'xyz'; known: t, flux_alpha"),
    ],
)
def test_a_column_that_does_not_exist(plain, name, message):
    with pytest.raises(FluxobsError) as caught:
        plain[name]
    assert message in str(caught.value)


def test_the_observer_that_ran(plain, adaptive):
    assert plain.plain is plain.observer
    assert plain.adaptive is None
    assert adaptive.adaptive is adaptive.observer
    assert adaptive.plain is adaptive.observer.plain
    assert adaptive.observer.psi_f_std == 0.02
    rerun = plain.observer.run(SAMPLES.voltage, SAMPLES.current)
    assert rerun.theta_e[-1] == pytest.approx(plain["theta_e"][-1], abs=1e-6)


def test_counts_and_statistics(plain):
    assert plain.counts == SampleCounts(0, 0, 0, 0, 0)
    assert (plain.statistics.rows, plain.statistics.total) == (ROWS, ROWS)
    assert plain.statistics.valid == plain["valid"].sum()
    gaps = {name: values.copy() for name, values in COLUMNS.items()}
    gaps["i_alpha"][[700, 900]] = np.nan
    result = fluxobs.estimate(gaps, SERVO)
    assert result.counts == SampleCounts(0, 0, 0, 0, 0)  # both were bridged before
    assert result.statistics.quality.marked["missing"].rows == 2


def test_str_is_summary_and_warnings(plain):
    assert str(plain) == plain.summary
    assert "2000 rows" in plain.summary
    assert (
        repr(plain) == f"<Result: arrays, surface-pmsm, {plain['valid'].sum()} of 2000 rows valid>"
    )
    swapped = COLUMNS | {"i_beta": -COLUMNS["i_beta"]}
    wrong = fluxobs.estimate(swapped, SERVO, unknowns="drift", causal=True)
    assert wrong.warnings
    assert str(wrong).startswith(wrong.summary)
    for text in wrong.warnings:
        assert f"\nWarning: {text}" in str(wrong)


def test_the_summary_of_the_adaptive_observer_has_its_parameters(adaptive):
    assert "(file 3.6 Ω)" in adaptive.summary
    assert adaptive["resistance"][-1] == pytest.approx(1.3 * PMSM.R_s, rel=0.05)


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
def test_write_estimates(plain, tmp_path, ending):
    plain.write(tmp_path / f"out{ending}")
    read = pl.read_csv if ending == ".csv" else pl.read_parquet
    assert read(tmp_path / f"out{ending}").equals(plain.estimates)
    assert [path.name for path in tmp_path.iterdir()] == [f"out{ending}"]


@pytest.mark.parametrize(
    ("ending", "magic"),
    [
        ("svg", b"<"),
        *(
            pytest.param(*e, marks=pytest.mark.slow)
            for e in (("pdf", b"%PDF"), ("png", b"\x89PNG"))
        ),
    ],
)
def test_write_a_picture(adaptive, tmp_path, ending, magic):
    adaptive.write(str(tmp_path / f"picture.{ending}"))
    assert (tmp_path / f"picture.{ending}").read_bytes().startswith(magic)


@pytest.mark.parametrize(("style", "width"), [("one column", 3.5), ("two columns", 7.16)])
def test_a_picture_for_a_paper(adaptive, style, width):
    figure = adaptive.plot(style, ["error", "speed", "resistance"])
    assert figure.get_figwidth() == width
    assert figure.get_suptitle() == ""
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert titles == ["Uncertainty of the position", "Speed", "Resistance"]
    assert len(adaptive.plot(style).axes) == 5
    figure.draw_without_rendering()
    for axes in figure.axes:  # no legend overlaps a title
        if axes.get_legend() is not None:
            assert (
                not axes.get_legend()
                .get_window_extent()
                .overlaps(axes._left_title.get_window_extent())
            )


def test_unknown_panels_and_styles(adaptive):
    for options, words in (
        ({"style": "one colum"}, "did you mean 'one column'"),
        ({"panels": ["eror"]}, "did you mean 'error'"),
        ({"panels": []}, "at most once: locus"),
        ({"panels": ["speed", "speed"]}, "at most once: locus"),
    ):
        with pytest.raises(fluxobs.UsageError, match=words):
            adaptive.plot(**options)


def test_plot(plain, adaptive):
    for result, names in ((plain, "θ_e ω_e"), (adaptive, "θ_e ω_e Ω")):
        figure = result.plot()
        assert isinstance(figure, Figure)
        labels = " ".join(axes.get_ylabel() + axes.get_title() for axes in figure.axes)
        for name in names.split():
            assert name in labels, labels


def test_estimates_written_to_out_are_the_same(plain, tmp_path):
    out = tmp_path / "out.parquet"
    progress = []
    result = fluxobs.estimate(
        COLUMNS | {"angle": SAMPLES.theta},
        SERVO,
        unknowns="drift",
        causal=True,
        truth={"theta_e": "angle"},
        out=out,
        progress=lambda done, total: progress.append((done, total)),
    )
    assert progress[-1] == (ROWS, ROWS)
    assert result.path == out
    assert result.estimates.equals(plain.estimates)
    assert result.summary == plain.summary
    out.unlink()
    with pytest.raises(FluxobsError, match=r"out\.parquet: the estimates cannot be read"):
        result["theta_e"]


def test_paths_that_cannot_be_written(plain, tmp_path):
    pl.DataFrame(COLUMNS).write_csv(tmp_path / "log.csv")
    from_file = fluxobs.estimate(tmp_path / "log.csv", SERVO, unknowns="drift", causal=True)
    before = (tmp_path / "log.csv").read_bytes()
    for path, words in (
        ("out.xlsx", "is written to"),
        ("picture.gif", "is written to"),
        ("nowhere/out.csv", "does not exist"),
        ("nowhere/picture.png", "cannot be written: No such file"),
        ("log.csv", "the log itself"),
    ):
        with pytest.raises(FluxobsError, match=words):
            from_file.write(tmp_path / path)
    assert (tmp_path / "log.csv").read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["log.csv"]


def test_the_command_that_exports_it(adaptive, plain, tmp_path):
    for result, machine, name in ((plain, "servo-400w", "one"), (adaptive, "pmsm-2kw2", "other")):
        text = result.export_command(machine)
        assert text.startswith(f"fluxobs export --machine {machine}")
        done = command(*text.replace("FOLDER", name).split()[1:], folder=tmp_path)
        assert done.returncode == 0, done.stderr
        assert (tmp_path / name / "motor_observer.h").exists()
    assert "--prior psi_f=0.02" in adaptive.export_command("pmsm-2kw2")


def test_learning_from_segments_of_a_long_log(tmp_path, monkeypatch):
    samples = course(R_s=1.3 * PMSM.R_s)
    pl.DataFrame(log_columns(samples)).write_parquet(tmp_path / "log.parquet")
    whole = estimate(tmp_path / "log.parquet", PMSM)
    assert "segments that are spread over the log" not in whole.summary
    monkeypatch.setattr(learning, "SEGMENTS", 3)
    monkeypatch.setattr(learning, "SEGMENT_ROWS", 4000)
    progress: list[tuple[int, int]] = []
    in_segments = estimate(tmp_path / "log.parquet", PMSM, progress=lambda *n: progress.append(n))
    assert "segments that are spread over the log" in in_segments.summary
    assert progress[-1] == (32_000, 32_000)
    assert in_segments.learnt.resistance == pytest.approx(1.3 * PMSM.R_s, rel=0.02)
    assert 4 * whole.learnt.resistance_std > in_segments.learnt.resistance_std


@pytest.mark.slow
def test_a_map_that_is_not_reciprocal_causes_a_warning():
    """Rotate the fluxes of a measured map against its currents by 10 degrees."""
    machine = fluxobs.example("ipm-5kw6")
    points = machine.flux_map
    samples = driven(
        machine, 1.25e-4, profile((0, 100), (2, 377)), -4 + 1j * profile((0, 3), (2, 9))
    )
    log = (samples.voltage, samples.current)
    for turn, warned in ((1.0, False), (np.exp(0.17j), True)):
        flux = FluxPoints(points.current, points.flux * turn)
        rotated = machine.with_values(flux_map=flux, L_d=None, L_q=None, psi_f=None)
        result = fluxobs.estimate(
            log, rotated, sample_time=1.25e-4, lag=1.0, unknowns="drift", causal=True
        )
        assert any("not reciprocal" in line for line in result.warnings) == warned


def test_a_result_is_a_table(plain):
    columns = plain.estimates.columns
    assert list(plain) == plain.keys() == columns
    assert "theta_e" in plain
    assert "theta" not in plain
    assert len(plain) == ROWS
    np.testing.assert_array_equal(plain["omega_e"], plain["speed_e"])
    assert plain.to_polars().equals(plain.estimates)
    assert pl.DataFrame(plain).equals(plain.estimates)  # by Arrow's interface


class Frame(dict):
    def set_index(self, name):
        return name, dict(self)


def test_a_result_as_a_table_of_another_package(plain, monkeypatch):
    """With stand-ins: the tests do not need these packages."""

    def dataset(columns, coords):
        return columns, coords

    monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=Frame))
    monkeypatch.setitem(sys.modules, "xarray", SimpleNamespace(Dataset=dataset))
    index, columns = plain.to_pandas()
    assert index == "t"
    np.testing.assert_array_equal(columns["speed_e"], plain["speed_e"])
    columns, coords = plain.to_xarray()
    assert coords["t"][2] == {"units": "s"}
    assert columns["flux_alpha"][2] == {"units": "Wb"}
    assert columns["theta_e_error"][2] == {"units": "rad"}
    assert {*columns, "t"} == set(plain)
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(FluxobsError, match="pip install xarray"):
        plain.to_xarray()


def test_every_column_has_a_unit(plain, adaptive):
    for result in (plain, adaptive):
        assert set(result) <= {*column_units(result.machine), "quality", "valid"}


def test_a_machine_may_be_the_fields_of_a_file():
    fields = {"kind": "surface-pmsm", "R_s": 0.5, "L_s": 1e-3, "psi_f": 0.01, "n_p": 4}
    assert as_machine(fields) == fluxobs.SurfacePMSM(R_s=0.5, L_s=1e-3, psi_f=0.01, n_p=4)
    with pytest.raises(fluxobs.MachineError, match="kind is missing"):
        as_machine({"R_s": 0.5})


def test_the_package_lists_its_own_names_only():
    assert dir(fluxobs) == sorted([*fluxobs.__all__, "__version__"])
