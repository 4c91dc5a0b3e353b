"""The results of this room do not change; those of arrays are compared as objects."""

import pytest

from fluxobs import identification
from support.frozen import check_compared_as_object, check_frozen, dataclasses_of, holds_arrays

CLASSES = dataclasses_of(identification)


@pytest.mark.parametrize("kind", CLASSES)
def test_no_field_can_be_set(kind):
    check_frozen(kind)


@pytest.mark.parametrize("kind", list(filter(holds_arrays, CLASSES)))
def test_what_holds_arrays_is_compared_as_an_object(kind):
    check_compared_as_object(kind)
