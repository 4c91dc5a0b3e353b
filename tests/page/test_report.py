"""A report recomputes its run, shows its contents, and sends no requests."""

import numpy as np
import pytest

import fluxobs
from fluxobs.presentation.report import write_report
from support.page_logs import written


def opened(window, path):
    report = window(path.read_text(encoding="utf-8"), viewport={"width": 1100, "height": 900})
    report.page.wait_for_selector("body[data-done]")
    return report


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "log.csv"
    path.write_text("".join(fluxobs.demo_log().path.read_text().splitlines(True)[:2001]))
    return fluxobs.estimate(path, "servo-400w", lag=0)


def test_it_recomputes_the_run(result, window, tmp_path):
    write_report(result, tmp_path / "r.html", command="fluxobs estimate log.csv")
    report = opened(window, tmp_path / "r.html")
    shown = report.page.inner_text("table.summary")
    for label, value in result.summary_rows:
        assert label.strip() in shown
        assert value in shown
    assert "fluxobs estimate log.csv" in report.page.inner_text("#more")
    for name in result.estimates.columns:
        shown, expected = report.column(name).astype(float), result[name].astype(float)
        np.testing.assert_allclose(shown, expected, rtol=0, atol=1e-6 * np.abs(expected).max())
    _move_a_slider(report, result)


def _move_a_slider(report, result):
    """The report shows the run with another magnet flux, and the first one again."""
    report.js(
        """() => { const s = document.getElementById("slider-psi_f"); s.value = 0.5;
                  s.dispatchEvent(new Event("input")); }"""
    )
    report.until("() => fluxobs.results.took > 0 && !fluxobs.results.running")
    changed = result.machine.with_values(psi_f=result.machine.psi_f * 2**0.5)
    unknowns = ",".join(result.unknowns)
    expected = fluxobs.estimate(result.log.path, changed, unknowns=unknowns, lag=0)
    np.testing.assert_allclose(report.column("theta_e"), expected["theta_e"], atol=1e-6)
    report.page.click(".sliders button")
    np.testing.assert_allclose(report.column("theta_e"), result["theta_e"], atol=1e-6)


def test_without_data_it_shows_the_estimates(result, window, tmp_path):
    write_report(result, tmp_path / "with.html")
    write_report(result, tmp_path / "without.html", data=False)
    report = opened(window, tmp_path / "without.html")
    assert report.page.locator(".sliders input").count() == 0
    assert "not in this file" in report.page.inner_text("#status")
    for name in ("theta_e", "speed_e", "drift_alpha", "theta_e_error"):
        noise = np.median(np.abs(np.diff(result[name], 3))) / 3
        error = np.abs(report.column(name) - result[name])
        assert error.max() <= max(noise / 2, 1e-6 * np.ptp(result[name])), name
    assert (report.column("valid") == result["valid"]).all()


@pytest.mark.slow
def test_an_immersed_run_is_shown_too(window, tmp_path):
    result = fluxobs.estimate(written("maglev-knospe", tmp_path), "maglev-knospe")
    write_report(result, tmp_path / "r.html")
    report = opened(window, tmp_path / "r.html")
    assert report.page.locator("figure").count() >= 2


#: Names that could run: the second would let a later script element end elsewhere, the third is
#: the template's placeholders.
EVIL = (
    "</script><script>document.body.dataset.evil = 1</script>",
    "<!--<script>",
    "{{blocks}} {{data}}",
)


def test_names_in_a_log_cannot_run(window, tmp_path):
    """The report of a run that the page recomputes at once."""
    log = fluxobs.demo_log().path
    causal = fluxobs.estimate(log, "servo-400w", unknowns="drift", causal=True)
    write_report(causal, tmp_path / "r.html", command=" ".join(("fluxobs estimate", *EVIL)))
    report = opened(window, tmp_path / "r.html")
    assert report.js("() => document.body.dataset.evil") is None
    shown = report.page.inner_text("#more")
    assert all(evil in shown for evil in EVIL)
    licences = report.page.locator("footer pre").text_content()
    for notice in ("fflate: Copyright", "uplot: Copyright", "Permission is hereby granted"):
        assert notice in licences
