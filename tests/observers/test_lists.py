"""C, the binding and Python share one list of outputs and one list of thresholds."""

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
    return {output.name: 2 if output.vector else 1 for output in outputs(estimate)}


@pytest.mark.parametrize("core", [_core, _core_single], ids=["double", "single"])
def test_the_core_returns_what_the_estimates_list(core):
    expected = listed(Estimate)
    del expected["valid"]  # returned separately
    assert dict(core.outputs) == expected
    expected = listed(AdaptiveEstimate)
    del expected["valid"]
    returned = dict(core.adaptive_outputs)
    returned["resistance"] = returned.pop("resistance_error")
    assert returned == expected


def test_units_are_in_the_header_too():
    """The comments of fo_estimate state the units of the list."""
    text = (FIRMWARE / "fluxobs.h").read_text()
    block = text[text.index("#define FO_ESTIMATE_FIELDS") : text.index("} fo_estimate")]
    for output in outputs(Estimate):
        line = next((row for row in block.split("\n") if f"({output.name})" in row), "")
        if output.unit:
            assert f"[{output.unit}]" in line, output.name


def test_files_end_with_valid_and_name_the_ports():
    names = [
        column
        for output in in_files(AdaptiveEstimate)
        for column in output.columns(("alpha", "beta"))
    ]
    assert names[:2] == ["flux_alpha", "flux_beta"]
    assert names[-1] == "valid"
    (std,) = (output for output in outputs(ImmersionEstimate) if output.name == "flux_std")
    assert std.columns(("1", "2")) == ("flux_1_std", "flux_2_std")


def test_docstrings_and_docs_come_from_the_list():
    for output in outputs(AdaptiveEstimate):
        assert re.search(rf"^    {output.name} : .*ndarray", AdaptiveEstimate.__doc__, re.M), (
            output.name
        )
        assert f"| `{output.name}` |" in markdown(("adaptive", AdaptiveEstimate))


def test_thresholds_equal_those_of_the_header():
    """The binding returns each threshold that the header defines, with its value."""
    text = (FIRMWARE / "fluxobs_internal.h").read_text()
    section = text[text.index("---- thresholds") : text.index("#define FO_THRESHOLDS")]
    defined = set(re.findall(r"^#define ([A-Z_]+) ", section, re.M))
    assert defined == set(_core.thresholds) == set(_core_single.thresholds)
    for name, value in _core.thresholds.items():
        assert value == pytest.approx(_core_single.thresholds[name], rel=1e-6)
    assert _core.thresholds["STD_LIMIT"] == pytest.approx(np.radians(3))


def test_no_python_file_repeats_a_threshold_of_c():
    """The twin and the immersed observer read their thresholds from the binding."""
    root = Path(fluxobs.__file__).parent
    for path in root.rglob("*.py"):
        for name in _core.thresholds:
            repetition = re.search(rf"^{name} *(: *\w+)? *= *[\d(]", path.read_text(), re.M)
            assert repetition is None, f"{path}: {name}"


@pytest.mark.parametrize("kind", ["Core", "Adaptive"])
def test_a_configuration_has_all_fields_and_no_other(kind):
    observer = AdaptiveObserver.for_machine(SERVO, sample_time=1e-4)
    calls = {}

    class Watch:
        def __getattr__(self, name):
            def make(*arguments):
                calls[name] = arguments
                return getattr(_core, name)(*arguments)

            return make

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plain, "_core", Watch())
        patch.setattr(adaptive, "_core", Watch())
        rebuilt = AdaptiveObserver.for_machine(SERVO, sample_time=1e-4)
    assert rebuilt.parameters() == observer.parameters()
    before, config, after = calls[kind][:-1], calls[kind][-1], ()
    if kind == "Core":  # its last argument is the flux map
        before, config, after = (), calls[kind][0], calls[kind][1:]
    make = getattr(_core, kind)
    for name in config:
        with pytest.raises(ValueError, match=f"{name} is missing"):
            make(*before, {key: value for key, value in config.items() if key != name}, *after)
    with pytest.raises(ValueError, match="unknown field"):
        make(*before, config | {"surplus": 1.0}, *after)
