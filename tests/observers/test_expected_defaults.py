"""Default settings of the observers."""

import dataclasses

import pytest

from fluxobs import AdaptiveObserver, ImmersionObserver, LeastSquaresObserver
from support.expected import check

OBSERVERS = (LeastSquaresObserver, AdaptiveObserver, ImmersionObserver)


@pytest.mark.parametrize("kind", OBSERVERS, ids=lambda kind: kind.__name__)
def test_usual_settings(kind):
    usual = {
        field.name: field.default
        for field in dataclasses.fields(kind)
        if field.default is not dataclasses.MISSING
    }
    assert usual
    check(f"observers/{kind.__name__}", {name: str(value) for name, value in usual.items()})
