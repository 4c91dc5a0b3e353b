"""Every sentence of the report shows the number that it names."""

import copy
import json
from pathlib import Path

from fluxobs.research.paper import deep
from fluxobs.research.paper.report import markdown

NUMBERS = json.loads((Path(__file__).parents[2] / "expected" / "reproduce.json").read_text())


def distinct_numbers():
    """Return (committed numbers with a different error for every observer, courses)."""
    results = copy.deepcopy(NUMBERS)
    courses = results["scenarios"]["S5"]["courses"]
    for k, course in enumerate(courses.values()):
        course["before"], course["end"] = 0.1 + k / 100, 0.5 + k / 100
    return results, courses


def row(text, start):
    return next(line for line in text.splitlines() if line.startswith(f"| {start}"))


def test_claims_show_the_numbers_of_their_observer():
    results, courses = distinct_numbers()
    text = markdown(results)
    printed = courses["adaptive, printed gain"]
    line = row(text, "Figure 3")
    assert f"{printed['before']:.2g} before and {printed['end']:.2g} after" in line
    line = row(text, "(these equations as printed")
    assert f"{courses['adaptive, printed gain and Φ']['end']:.2g} at the end" in line
    ratio = courses["robust, printed gain"]["end"] / courses["voltage model"]["end"]
    line = row(text, "Figure 2")
    assert f"error ratio {ratio:.3f}" in line
    assert f"bounded: {courses['robust, balanced gain']['before']:.2g} rms" in line
    for name, course in courses.items():
        if name != "adaptive, printed gain":
            assert f"{course['end']:.2g} after" not in row(text, "Figure 3"), name


def test_tables_follow_the_numbers():
    results, courses = distinct_numbers()
    text = markdown(results)
    for name, course in courses.items():
        assert f"| {name} | {course['before']:.2g} | {course['end']:.2g} |" in text
    stability = {
        "period": 6.2832,
        "attracts": 0.1,
        "before": {"0.01": [0.00013, 1e-9], "1": [0.0082, 1e-9]},
        "after": {"0.01": [0.002, 0.001], "1": [-0.001, 0.005]},
        "limits": {"before": [17.9, 0.0216], "after": [16.5, -0.0232]},
    }
    results["scenarios"]["S5"]["stability"] = stability
    text = markdown(results)
    assert "| S5, before the jump | 6.283 s | +0.00013 | +0.0082 | +17.9 | +0.0216 |" in text
    assert (
        "| S5, after the jump | 6.283 s | +0.0020 ± 0.0010 | 0 ± 0.005 | +16.5 | -0.0232 |" in text
    )
    stability["period"] = None
    assert "| S5, before the jump | none |" in markdown(results)
    courses["voltage model"]["end"] = 5e44
    assert "diverges" in row(markdown(results), "voltage model")


def test_deep_sections_follow_the_numbers():
    course = {"before": 0.11, "end": 0.22}
    run = {
        "error": 0.008,
        "claimed": 0.009,
        "within": 0.96,
        "slope_uncertainty": 0.5,
        "valid": True,
    }
    results = {
        "all_rows": {"S5": {"least_squares": 0.037, "runs": [run, {**run, "error": 0.0095}]}},
        "at_rest": {
            "position": 7.3e-7,
            "flux": 0.0026,
            "position_std": 7.5e-7,
            "flux_std": 0.0027,
            "bound": 7.46e-7,
        },
        "scalar_gain": {
            "alpha": 6.4e-5,
            "gains": [1.0, 10.0],
            "multipliers": {"1": [1.5, 2.5], "0.5": [0.95, 1.75]},
        },
        "later_line": {"S5": {"Riccati": course}},
        "observability": {"S5": {"least": 1e-5, "flux_std": 0.023}},
        "erratum_8": {
            "literal_growth": 2.396e4,
            "poles": [[-0.11, 0.0], [-41.0, 8641.0], [-41.0, -8641.0]],
            "printed_poles": [[-2.6, 0.0]],
            "stiffness": 1e-5,
            "stiffness_without_flux": 0.0,
        },
        "closed_loop": {
            "levitation": {
                "least squares": {
                    "handed_over": 1.1,
                    "lost": None,
                    "before": 0.13,
                    "after": 0.14,
                    "peak": 0.35,
                    "flux_error": 1e-12,
                    "valid": 0.99,
                },
                "adaptive, repaired": {
                    "handed_over": None,
                    "lost": 15.03,
                    "before": 0.13,
                    "after": float("inf"),
                    "peak": 0.9,
                    "flux_error": float("inf"),
                    "valid": 0.2,
                },
            }
        },
    }
    text = "\n".join(deep.markdown(results))
    assert "| S5 | 3.7% | 0.8% … 0.9% | 0.9% … 0.9% | 96.0% … 96.0% | 0.5 | yes |" in text
    assert "known to 0.73 µm (stated: 0.75 µm; closed form: 0.75 µm)" in text
    assert "The law is unstable at 3 of 4 gains" in text
    assert "at least 1.750" in text
    assert "| as they are | 1.5 | 2.5 |" in text
    assert "| × 0.5 | 0.95 | 1.75 |" in text
    assert "| Riccati | 0.11; 0.22 |" in text
    assert "| S5 | 1.0e-05 | 2.3% |" in text
    assert "-0.11, -41 ± 8641j 1/s with corrected z̃₂ and -2.6 1/s with printed z̃₂" in text
    assert "| levitation | least squares | 1.10 | no | 0.13 | 0.14 | 0.35 | < 1e-9 |" in text
    assert "| adaptive, repaired | never | 15.03 | 0.13 | – | 0.9 | – |" in text
