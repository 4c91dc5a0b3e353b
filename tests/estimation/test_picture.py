"""Panels of a picture from given rows: lines, bands and limits are known in closed form."""

from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.colors import to_hex

from fluxobs.core.plots import new_figure
from fluxobs.estimation.truth import TruthFit, TruthParameter
from fluxobs.presentation import picture

T = np.linspace(0.0, 1.0, 200)
VALID = (T > 0.2).astype(float)
SERIES = {
    "t": T,
    "valid": VALID,
    "theta_e": np.angle(np.exp(20j * T)),
    "theta_e_std": np.full(200, np.radians(1.5)),
    "theta_e_error": np.radians(0.5) * np.cos(9 * T),
    "speed_e": 20.0 + T,
    "drift_alpha": 0.002 + 0 * T,
    "drift_beta": -0.001 * T,
    "flux_alpha": 0.02 * np.cos(20 * T),
    "flux_beta": 0.02 * np.sin(20 * T),
    "psi_f": np.full(200, 0.0125),
}
ROWS_VALID = VALID > 0


@pytest.fixture
def axes():
    return new_figure(figsize=(11, 8)).subplots()


def line(axes, label=None):
    lines = [
        candidate for candidate in axes.lines if label is None or candidate.get_label() == label
    ]
    return np.asarray(lines[0].get_xdata(), float), np.asarray(lines[0].get_ydata(), float)


def band(axes, number=0):
    """Return the lower and upper limit of a filled band."""
    y = axes.collections[number].get_paths()[0].vertices[:, 1]
    return y.min(), y.max()


@pytest.mark.parametrize(("size", "scale", "unit"), [(0.49, 1e3, "mWb"), (0.51, 1.0, "Wb")])
def test_the_locus(axes, size, scale, unit):
    """The unit is mWb if the flux is below half a Weber; only valid rows are drawn."""
    picture._locus(axes, SERIES | {"psi_f": np.full(200, size)})
    x, y = line(axes, "λ")
    np.testing.assert_allclose(x, scale * SERIES["flux_alpha"][ROWS_VALID])
    np.testing.assert_allclose(y, scale * SERIES["flux_beta"][ROWS_VALID])
    x, y = line(axes, "λ - L i, along d")
    np.testing.assert_allclose(x + 1j * y, scale * size * np.exp(20j * T[ROWS_VALID]))
    assert axes.get_xlabel() == f"α [{unit}]"
    assert axes.get_ylabel() == f"β [{unit}]"


def test_the_position_in_degrees_with_gaps_where_it_wraps(axes):
    picture._position(axes, SERIES | {"truth": SERIES["theta_e"] - 0.01})
    for label, error in (("estimated", 0.0), ("true", 0.01)):
        _, y = line(axes, label)
        expected = np.degrees(SERIES["theta_e"] - error)
        drawn = np.isfinite(y)
        np.testing.assert_allclose(y[drawn], expected[: len(y)][drawn])
        assert (~drawn).sum() == 3  # in 20 rad
        assert np.abs(np.diff(y[drawn])).max() > 180
    assert axes.get_ylim() == (-190, 190)
    assert axes.get_xlim() == (0.0, 1.0)
    assert axes.get_yticks().tolist() == [-180, -90, 0, 90, 180]


def test_angles_are_joined_up_to_half_a_turn():
    degrees = picture._degrees_with_gaps(np.radians([0.0, 179.0, 0.0, 181.0, 0.0]))
    np.testing.assert_allclose(degrees, [0.0, 179.0, 0.0, np.nan, np.nan])


def test_a_position_that_was_never_valid(axes):
    picture._position(axes, {})
    assert axes.texts[0].get_text() == "no valid position"
    assert axes.texts[0].get_position() == (0.5, 0.5)


@pytest.mark.parametrize("first", [0, 100, 900])
def test_eight_turns_around_the_first_valid_row(first):
    """The panel shows as many rows before the first valid row as after it."""
    theta = 2 * np.pi * 0.0205 * np.arange(2000)
    rows = {
        "theta_e": np.angle(np.exp(1j * theta)),
        "valid": (np.arange(2000) >= first).astype(float),
        "t": np.arange(2000.0),
    }
    ahead = int(np.floor(8 / 0.0205)) + 1
    t = picture._few_periods(rows)["t"]
    assert (t[0], t[-1]) == (max(0, first - ahead), first + ahead - 1)
    slow = rows | {"theta_e": 0.001 * np.arange(2000)}
    assert len(picture._few_periods(slow)["t"]) == 2000


def test_the_error_and_its_band_of_two_standard_deviations(axes):
    picture._error(axes, SERIES)
    assert band(axes) == pytest.approx((-3.0, 3.0))
    _, y = line(axes, "error")
    np.testing.assert_allclose(y[ROWS_VALID], 0.5 * np.cos(9 * T[ROWS_VALID]))
    assert np.isnan(y[~ROWS_VALID]).all()
    assert axes.get_ylim() == pytest.approx((-1.4 * 3.0, 1.4 * 3.0))
    assert axes.get_title(loc="left") + axes.get_title() == "Position error"


def test_limits_of_the_error_ignore_few_rows():
    """The limits include 99 % of the band and 99.5 % of the error."""
    figure = new_figure()
    large = SERIES | {"theta_e_error": np.radians(np.where(np.arange(200) < 198, 10.0, 1000.0))}
    wide = figure.subplots()
    picture._error(wide, large)
    error = np.where(np.arange(200) < 198, 10.0, 1000.0)[ROWS_VALID]
    assert wide.get_ylim()[1] == pytest.approx(1.4 * np.percentile(error, 99.5))
    std = np.where(np.arange(200) < 198, 1.0, 50.0)
    narrow = new_figure().subplots()
    rows = {name: values for name, values in SERIES.items() if name != "theta_e_error"}
    picture._error(narrow, rows | {"theta_e_std": np.radians(std)})
    assert narrow.get_ylim()[1] == pytest.approx(1.4 * 2 * np.percentile(std[ROWS_VALID], 99))
    assert "Uncertainty" in narrow.get_title(loc="left") + narrow.get_title()


def test_an_error_without_valid_rows(axes):
    picture._error(axes, SERIES | {"valid": 0 * T})
    assert axes.get_ylim() == pytest.approx((-14.0, 14.0))


def fit(value, std=0.01):
    zero = TruthParameter("zero", value, std, "rad")
    return TruthFit("theta_e", (zero,), 1, (), 0.01, 0.02, known={"zero": value})


@pytest.mark.parametrize(("value", "corrected"), [(0.029, False), (0.031, True)])
def test_a_title_says_that_a_fit_was_subtracted(axes, value, corrected):
    picture._error(axes, SERIES, fit(value))
    title = axes.get_title(loc="left") + axes.get_title()
    assert ("against the corrected truth" in title) == corrected


def test_errors_are_against_the_corrected_truth():
    raw = SERIES["theta_e"] - 0.3 - 0.01 * np.cos(T)
    scored = picture._scored(SERIES | {"raw": raw}, fit(0.3))
    np.testing.assert_allclose(scored["theta_e_error"], 0.01 * np.cos(T), atol=1e-12)
    np.testing.assert_allclose(scored["truth"], SERIES["theta_e"] - 0.01 * np.cos(T), atol=1e-12)
    assert picture._scored(SERIES, fit(0.3)) is SERIES
    speed = TruthFit("speed_e", (TruthParameter("gain", 1.0, 0.1, "1"),), 1, (), 0.0, 0.0)
    assert picture._scored(SERIES | {"raw": raw}, speed)["theta_e_error"] is SERIES["theta_e_error"]


def test_speed_and_drift_of_valid_rows(axes):
    picture._speed(axes, SERIES, 4)
    _, y = line(axes)
    np.testing.assert_array_equal(y[ROWS_VALID], SERIES["speed_e"][ROWS_VALID])
    assert np.isnan(y[~ROWS_VALID]).all()
    drift = new_figure().subplots()
    picture._drift(drift, SERIES)
    np.testing.assert_allclose(line(drift, "α")[1][ROWS_VALID], 2.0)
    np.testing.assert_allclose(line(drift, "β")[1][ROWS_VALID], -T[ROWS_VALID])
    for panel in (axes, drift):
        zero = panel.lines[-1]
        assert np.asarray(zero.get_ydata()).tolist() == [0, 0]


@pytest.mark.parametrize(("width", "long"), [(8.1, True), (8.0, False), (3.5, False)])
def test_titles_are_short_in_print(width, long):
    panel = new_figure(figsize=(width, 3)).subplots()
    picture._set_title(panel, "long", "short")
    assert panel.get_title(loc="left") + panel.get_title() == ("long" if long else "short")


def test_a_parameter_with_its_band(axes):
    columns = {
        "t": T,
        "adapting": VALID,
        "resistance": np.full(200, 0.4),
        "resistance_std": np.full(200, 0.05),
    }
    picture._parameter(axes, "resistance", columns, 0.36)
    assert band(axes) == pytest.approx((0.3, 0.5))
    _, y = line(axes)
    np.testing.assert_array_equal(np.isnan(y), VALID == 0)
    assert line(axes, "assumed")[1].tolist() == [0.36, 0.36]
    assert (columns["resistance"] == 0.4).all()


def test_rows_that_are_not_valid_are_grey(axes):
    picture._shade_invalid(axes, SERIES)
    (grey,) = axes.collections
    x, y = grey.get_paths()[0].vertices.T
    assert x.min() == 0.0
    assert x.max() == pytest.approx(0.2, abs=1 / 199)
    assert (y.min(), y.max()) == (0.0, 1.0)
    assert to_hex(grey.get_facecolor()[0]) == "#e0e0e0"
    assert grey.get_zorder() == 0


@pytest.mark.parametrize(("gaps", "marks"), [(0, 0), (1, 1), (399, 399), (400, 200), (1001, 201)])
def test_gaps_are_marked_but_not_thousands_of_them(axes, gaps, marks):
    clock = SimpleNamespace(t=np.arange(gaps + 1.0))
    picture._gaps(axes, SimpleNamespace(log=SimpleNamespace(clock=clock)))
    assert len(axes.lines) == marks
    labels = [mark.get_label() for mark in axes.lines]
    assert labels.count("gap in the log") == min(gaps, 1)
    assert (axes.get_legend() is not None) == bool(gaps)
    if gaps:
        assert axes.lines[0].get_xdata()[0] == 1.0


@pytest.mark.parametrize("learnt", [{}, {"a": 0}, {"a": 0, "b": 0}, {"a": 0, "b": 0, "c": 0}])
def test_six_columns_of_panels(learnt):
    mosaic = picture._layout(learnt, ())
    assert {len(row) for row in mosaic} == {6}
    assert [row.count("locus") for row in mosaic[:4]] == [2, 2, 0, 0]
    assert {row.index("position") for row in mosaic[:1]} == {2}
    for name in learnt:
        assert mosaic[-1].count(name) == 6 // len(learnt)


def test_numbers_in_the_title():
    statistics = SimpleNamespace(
        valid=10, scored=5, rms_error=np.radians(2.5), mean={"psi_f": 0.0125}.get
    )
    layout = SimpleNamespace(lag=-1.0)
    result = SimpleNamespace(statistics=statistics, log=SimpleNamespace(layout=layout))
    title = picture._numbers(result, None)
    assert title == "\nlag -1  ·  |λ - L i| = 12.5 mWb  ·  position error 2.50° rms on valid rows"
    assert "0.57° rms" in picture._numbers(result, fit(0.3))
    statistics.scored = 0
    assert "error" not in picture._numbers(result, None)
    statistics.valid = 0
    assert "no valid position" in picture._numbers(result, None)


def test_vectors_with_bands(axes):
    columns = SERIES | {"drift_alpha_std": np.full(200, 0.001)}
    picture._pair(axes, columns, "drift", ("alpha", "beta"), 10.0)
    np.testing.assert_allclose(line(axes, "alpha")[1][ROWS_VALID], 0.02)
    assert band(axes) == pytest.approx((0.0, 0.04))
    assert len(axes.collections) == 1


def immersed(more, unit="°", factor=180 / np.pi):
    """Draw the picture of the immersed observer."""
    columns = SERIES | {"noise_share": np.full(200, 0.05)} | more
    position = SimpleNamespace(unit=unit, factor=factor, name="theta_e", title="Position")
    statistics = SimpleNamespace(thin=SimpleNamespace(columns=lambda: columns), valid=160, rows=200)
    machine = SimpleNamespace(ports=("alpha", "beta"), position_output=position, kind="kind")
    path = SimpleNamespace(name="log")
    result = SimpleNamespace(statistics=statistics, machine=machine, log=SimpleNamespace(path=path))
    return picture._immersed(result)


@pytest.mark.parametrize(("unit", "scale", "prefix"), [("°", 1e3, "mWb"), (" mm", 1e6, "µWb")])
def test_the_picture_of_the_immersed_observer(unit, scale, prefix):
    figure = immersed({}, unit)
    flux, position, drift, share = figure.axes
    np.testing.assert_allclose(line(flux)[1][ROWS_VALID], scale * SERIES["flux_alpha"][ROWS_VALID])
    expected = np.degrees(SERIES["theta_e"])
    np.testing.assert_allclose(line(position)[1][ROWS_VALID], expected[ROWS_VALID])
    np.testing.assert_allclose(line(drift)[1][ROWS_VALID], 0.002)
    np.testing.assert_allclose(line(share)[1], 0.05)
    assert share.get_yscale() == "log"
    assert prefix in flux.get_title(loc="left") + flux.get_title()
    assert "position valid on 80.0% of 200 rows" in figure.get_suptitle()
    assert share.get_xlim() == (0.0, 1.0)
    bias = {"current_bias_alpha": 0.1 + 0 * T, "current_bias_beta": T}
    bias_panel = immersed(bias, unit).axes[3]
    np.testing.assert_allclose(line(bias_panel)[1][ROWS_VALID], 0.1)


@pytest.mark.parametrize(
    ("style", "panels", "size"),
    [
        ("screen", ["speed", "drift"], (11.0, 4.0)),
        ("one column", ["locus", "speed"], (3.5, 1.35 * 2.6)),
        ("two columns", ["locus", "speed", "drift"], (7.16, 1.6 * 2.6)),
    ],
)
def test_sizes_of_chosen_panels(style, panels, size, monkeypatch):
    """Panels fill the page width; the locus is higher; a last odd panel takes a whole row."""
    monkeypatch.setattr(picture, "_draw", lambda *_: None)
    paper = picture.STYLES[style]
    figure = picture._chosen(None, None, paper, panels, picture.PANELS)
    assert (figure.get_figwidth(), figure.get_figheight()) == pytest.approx(size)
    assert len(figure.axes) == len(panels)
    assert {axes.get_xlabel() for axes in figure.axes} == {"t [s]"}
    spans = [len(axes.get_subplotspec().colspan) for axes in figure.axes]
    assert spans == ([1, 1, 2] if style == "two columns" else [1] * len(panels))
