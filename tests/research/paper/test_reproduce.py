"""Section V with one command: the numbers agree with the committed numbers and are reproducible.

``python tests/research/paper/test_reproduce.py`` rewrites the expected numbers.
"""

import json
import math
from pathlib import Path

import pytest

from fluxobs import FluxobsError
from fluxobs.research.paper.reproduce import reproduce
from fluxobs.research.paper.scenario import run_levitation
from support.cli import fluxobs

EXPECTED = Path(__file__).parents[2] / "expected" / "reproduce.json"
FIGURES = (
    "figure_2",
    "figure_3",
    "robust",
    "adaptive_flux",
    "adaptive_parameters",
    "baselines",
    "trajectories",
    "pmsm",
    "counter_example",
)
#: Below ROUNDING, an error is a rounding error; above UNBOUNDED, it grows without bound. In both
#: cases, the digits differ between machines.
ROUNDING, UNBOUNDED = 1e-5, 1e2


def compare(actual, expected, path=""):
    if isinstance(expected, dict):
        assert set(actual) == set(expected), path
        for key in expected:
            compare(actual[key], expected[key], f"{path}/{key}")
    elif isinstance(expected, list):
        assert len(actual) == len(expected), path
        for k, (value, other) in enumerate(zip(actual, expected, strict=True)):
            compare(value, other, f"{path}/{k}")
    elif isinstance(expected, float):
        if "settled" in path:
            assert actual == pytest.approx(expected, rel=0.1, abs=0.05), path
        elif abs(expected) > UNBOUNDED:
            assert math.log10(actual) == pytest.approx(math.log10(expected), abs=1), path
        elif "mechanics" in path or abs(expected) > ROUNDING:
            assert actual == pytest.approx(expected, rel=0.02), path
        else:
            assert abs(actual) < 10 * ROUNDING, path
    else:
        assert actual == expected, path


@pytest.mark.slow
def test_quick_run_writes_figures_report_and_the_committed_numbers(tmp_path):
    process = fluxobs("reproduce", "--quick", "--out", "paper", folder=tmp_path)
    assert process.returncode == 0, process.stderr
    numbers = json.loads((tmp_path / "paper" / "numbers.json").read_text())
    compare(numbers, json.loads(EXPECTED.read_text()))
    report = (tmp_path / "paper" / "report.md").read_text()
    for name in FIGURES:
        assert (tmp_path / "paper" / f"{name}.png").stat().st_size > 10_000
        assert f"({name}.png)" in report
    page = (tmp_path / "paper" / "report.html").read_text()
    assert page.count("<img") == len(FIGURES)
    assert page.count("<table>") == report.count("| --- |\n")
    assert 'src="data:' in page
    assert ".png" not in page
    # These statements of the report must hold.
    courses = numbers["scenarios"]["S5"]["courses"]
    assert courses["adaptive, repaired"]["settled"]["0.001"] < 10
    assert courses["least squares"]["settled"]["0.02"] < 0.3
    assert courses["least squares"]["settled"]["1e-06"] < 2
    assert courses["adaptive, printed gain"]["settled"]["0.02"] is None
    ratio = courses["robust, printed gain"]["end"] / courses["voltage model"]["end"]
    assert ratio == pytest.approx(1, abs=1e-3)
    rms = numbers["scenarios"]["S5"]["robust"]["rms"]
    assert rms["2"] / rms["1"] == pytest.approx(2, rel=0.1)


@pytest.mark.slow
def test_two_runs_agree_to_the_last_digit():
    first, second = run_levitation("S5", quick=True), run_levitation("S5", quick=True)
    for name, course in first.courses.items():
        assert course.flux.tobytes() == second.courses[name].flux.tobytes(), name
    assert first.robust == second.robust
    assert first.mechanics == second.mechanics


def test_quick_and_deep_exclude_each_other(tmp_path):
    process = fluxobs("reproduce", "--quick", "--deep", "--out", "paper", folder=tmp_path)
    assert process.returncode == 2
    assert "exclude each other" in process.stderr


def test_a_folder_that_cannot_be_created(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(FluxobsError, match="cannot be created"):
        reproduce(tmp_path / "file" / "paper", quick=True)


if __name__ == "__main__":
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        numbers = reproduce(folder, quick=True)
    EXPECTED.write_text(json.dumps(numbers, indent=1) + "\n")
