"""Tests that results are immutable, and that results with arrays are compared by identity."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import pkgutil
from collections.abc import Callable
from types import ModuleType

import pytest


def dataclasses_of(room: ModuleType) -> list[type]:
    """Return all dataclasses that the modules of a package define."""
    names = [f"{room.__name__}.{module.name}" for module in pkgutil.iter_modules(room.__path__)]
    classes = [
        kind
        for name in names
        for _, kind in inspect.getmembers(importlib.import_module(name), inspect.isclass)
        if kind.__module__ == name and dataclasses.is_dataclass(kind)
    ]
    assert classes
    return classes


def holds_arrays(kind: type) -> bool:
    """Whether a field is an array, or a list or mapping of arrays."""
    types = ("Array", "Complex", "NDArray")
    return any(name in str(field.type) for field in dataclasses.fields(kind) for name in types)


def frozen_tests(room: ModuleType) -> tuple[Callable[[type], None], Callable[[type], None]]:
    """Return two tests of a package's dataclasses; assigned to names `test_…`, both will run."""
    classes = dataclasses_of(room)

    @pytest.mark.parametrize("kind", classes)
    def no_field_can_be_set(kind: type) -> None:
        blank = object.__new__(kind)
        for field in dataclasses.fields(kind):
            with pytest.raises(dataclasses.FrozenInstanceError):
                setattr(blank, field.name, None)

    @pytest.mark.parametrize("kind", [kind for kind in classes if holds_arrays(kind)])
    def compared_as_an_object(kind: type) -> None:
        blank, other = object.__new__(kind), object.__new__(kind)
        assert len({blank, other}) == 2  # == would need the truth value of an array

    return no_field_can_be_set, compared_as_an_object
