"""Results of this room are immutable; results with arrays are compared by identity."""

from fluxobs import identification
from support.frozen import frozen_tests

test_no_field_can_be_set, test_what_holds_arrays_is_compared_as_an_object = frozen_tests(
    identification
)
