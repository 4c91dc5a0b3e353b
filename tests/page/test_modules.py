"""Modules of the package that the page loads by name exist."""

import importlib.util
import re
from pathlib import Path

import pytest

APP = Path(__file__).parents[2] / "web" / "app"
NAMES = {
    name
    for script in APP.glob("*.js")
    for name in re.findall(r'\$py\("([\w.]+)"\)', script.read_text("utf-8"))
}


@pytest.mark.parametrize("name", sorted(NAMES))
def test_a_module_that_the_page_loads_exists(name):
    assert importlib.util.find_spec(f"fluxobs.{name}") is not None
