"""Observers and estimates are immutable; their repr leaves out derived settings."""

import dataclasses

import pytest

from fluxobs import AdaptiveObserver, ImmersionObserver, LeastSquaresObserver, observers
from support.frozen import frozen_tests

test_no_field_can_be_set, _ = frozen_tests(observers)


@pytest.mark.parametrize("kind", [LeastSquaresObserver, AdaptiveObserver, ImmersionObserver])
def test_derived_fields_are_not_in_the_repr(kind):
    names = [field.name for field in dataclasses.fields(kind) if field.repr]
    assert len(names) > 5
    assert not any(name.startswith("_") for name in names)
