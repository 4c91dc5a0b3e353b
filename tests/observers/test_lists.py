"""One list of outputs, one of thresholds: C, the binding and Python name the same things."""

import re
from pathlib import Path

import numpy as np
import pytest

import fluxobs
from fluxobs import AdaptiveObserver, _core, _core_single
from fluxobs.observers import (
    AdaptiveEstimate,
    Estimate,
    ImmersionEstimate,
    adaptive,
    in_files,
    outputs,
    plain,
)
from fluxobs.observers.outputs import markdown
from support.firmware import FIRMWARE
from support.records import SERVO


def listed(estimate):
    return {one.name: 2 if one.vector else 1 for one in outputs(estimate)}


@pytest.mark.parametrize("core", [_core, _core_single], ids=["double", "single"])
def test_the_core_returns_what_the_estimates_list(core):
    expected = listed(Estimate)
    del expected["valid"]  # goes apart
    assert dict(core.outputs) == expected
    expected = listed(AdaptiveEstimate)
    del expected["valid"]
    returned = dict(core.adaptive_outputs)
    returned["resistance"] = returned.pop("resistance_error")
    assert returned == expected


def test_units_stand_in_the_header_too():
    """The comments of fo_estimate carry the units of the list."""
    text = (FIRMWARE / "fluxobs.h").read_text()
    block = text[text.index("#define FO_ESTIMATE_FIELDS") : text.index("} fo_estimate")]
    for one in outputs(Estimate):
        line = next((row for row in block.split("\n") if f"({one.name})" in row), "")
        if one.unit:
            assert f"[{one.unit}]" in line, one.name


def test_files_end_with_valid_and_name_the_ports():
    names = [c for one in in_files(AdaptiveEstimate) for c in one.columns(("alpha", "beta"))]
    assert names[:2] == ["flux_alpha", "flux_beta"]
    assert names[-1] == "valid"
    (std,) = (one for one in outputs(ImmersionEstimate) if one.name == "flux_std")
    assert std.columns(("1", "2")) == ("flux_1_std", "flux_2_std")


def test_docstrings_and_docs_come_from_the_list():
    for one in outputs(AdaptiveEstimate):
        assert re.search(rf"^    {one.name} : .*ndarray", AdaptiveEstimate.__doc__, re.M), one.name
        assert f"| `{one.name}` |" in markdown(("adaptive", AdaptiveEstimate))


def test_thresholds_are_those_of_the_header():
    """Every one that the header defines is in its list, and comes out with its value."""
    text = (FIRMWARE / "fluxobs_internal.h").read_text()
    section = text[text.index("---- thresholds") : text.index("#define FO_THRESHOLDS")]
    defined = set(re.findall(r"^#define ([A-Z_]+) ", section, re.M))
    assert defined == set(_core.thresholds) == set(_core_single.thresholds)
    for name, value in _core.thresholds.items():
        assert value == pytest.approx(_core_single.thresholds[name], rel=1e-6)
    assert _core.thresholds["STD_LIMIT"] == pytest.approx(np.radians(3))


def test_no_python_file_repeats_a_threshold_of_c():
    """The twin and the immersed observer read them."""
    root = Path(fluxobs.__file__).parent
    for path in root.rglob("*.py"):
        for name in _core.thresholds:
            found = re.search(rf"^{name} *(: *\w+)? *= *[\d(]", path.read_text(), re.M)
            assert found is None, f"{path}: {name}"


@pytest.mark.parametrize("kind", ["Core", "Adaptive"])
def test_a_configuration_has_all_fields_and_no_other(kind):
    observer = AdaptiveObserver.for_machine(SERVO, sample_time=1e-4)
    taken = {}

    class Watch:
        def __getattr__(self, name):
            def make(*arguments):
                taken[name] = arguments
                return getattr(_core, name)(*arguments)

            return make

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plain, "_core", Watch())
        patch.setattr(adaptive, "_core", Watch())
        again = AdaptiveObserver.for_machine(SERVO, sample_time=1e-4)
    assert again.parameters() == observer.parameters()
    before, config, after = taken[kind][:-1], taken[kind][-1], ()
    if kind == "Core":  # its last argument is the flux map
        before, config, after = (), taken[kind][0], taken[kind][1:]
    make = getattr(_core, kind)
    for name in config:
        with pytest.raises(ValueError, match=f"{name} is missing"):
            make(*before, {k: v for k, v in config.items() if k != name}, *after)
    with pytest.raises(ValueError, match="unknown field"):
        make(*before, config | {"surplus": 1.0}, *after)
