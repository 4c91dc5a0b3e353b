"""The examples in docstrings give the printed results."""

import doctest
import importlib
import pkgutil

import pytest

import fluxobs

NAMES = sorted(
    module.name
    for module in pkgutil.walk_packages(fluxobs.__path__, "fluxobs.")
    if not module.name.rpartition(".")[2].startswith("_")
)


@pytest.mark.parametrize("name", NAMES)
def test_examples(name):
    assert doctest.testmod(importlib.import_module(name)).failed == 0
