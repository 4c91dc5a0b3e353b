"""Observers and estimates do not change; what is derived of their settings is not shown."""

import dataclasses

import pytest

from fluxobs import AdaptiveObserver, ImmersionObserver, LeastSquaresObserver, observers
from support.frozen import frozen_tests

test_no_field_can_be_set, _ = frozen_tests(observers)


@pytest.mark.parametrize("kind", [LeastSquaresObserver, AdaptiveObserver, ImmersionObserver])
def test_what_is_derived_is_not_shown(kind):
    shown = [field.name for field in dataclasses.fields(kind) if field.repr]
    assert len(shown) > 5
    assert not any(name.startswith("_") for name in shown)
