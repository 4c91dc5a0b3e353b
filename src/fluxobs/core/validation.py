"""Checks of user input; messages name the field, the value given and what is allowed."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from numbers import Real
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from ..errors import UsageError

#: Limits of a quantity in SI units, far beyond any machine: products of a dozen such numbers are
#: neither zero nor infinite.
LEAST, LARGEST = 1e-24, 1e24
Number = Annotated[float, Field(ge=-LARGEST, le=LARGEST, allow_inf_nan=False)]
Positive = Annotated[float, Field(ge=LEAST, le=LARGEST, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, le=LARGEST, allow_inf_nan=False)]


class Table(BaseModel):
    """Immutable table of a user's file; for an unknown key, the error suggests a known key."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    @model_validator(mode="before")
    @classmethod
    def _check_names(cls, fields: Any) -> Any:
        if isinstance(fields, Mapping):
            for name in fields:
                if name not in cls.model_fields:
                    raise ValueError(f"unknown field {name!r}{nearest(name, cls.model_fields)}")
        return fields


def number(name: str, value: object, unit: str) -> float:
    """Return the value as a float; raise UsageError if it is not a number."""
    if isinstance(value, bool) or not isinstance(value, Real):
        raise UsageError(f"{name} must be a number [{unit}], got {value!r}")
    return float(value)


def nearest(word: str, known: Iterable[str]) -> str:
    """Suggest the known name that is probably meant, or list all known names."""
    known = list(known)
    matches = difflib.get_close_matches(word, known, n=1, cutoff=0.5)
    return f"; did you mean {matches[0]!r}?" if matches else f"; known: {', '.join(known)}"


def complaints(error: ValidationError, fields: Iterable[str], what: str) -> str:
    """Return one clause per problem. `what` names the owner of the fields: "kind surface-pmsm"."""
    fields = list(fields)
    clauses = []
    for problem in error.errors():
        name = ".".join(str(key) for key in problem["loc"])
        value = problem.get("input")
        match problem["type"]:
            case "missing":
                clauses.append(f"{name} is missing: {what} needs it")
            case "extra_forbidden":
                clauses.append(f"unknown field {name!r}{nearest(name, fields)}")
            case "greater_than":
                clauses.append(f"{name} must be positive, got {value}")
            case "greater_than_equal":
                limit = float(problem["msg"].split(" ")[-1])
                positive = limit == LEAST and isinstance(value, Real) and value <= 0
                words = "positive" if positive else f"at least {limit:.9g}"
                clauses.append(f"{name} must be {words}, got {value}")
            case "less_than_equal":
                limit = float(problem["msg"].split(" ")[-1])
                clauses.append(f"{name} must be at most {limit:.9g}, got {value}")
            case "value_error":
                message = problem["msg"].removeprefix("Value error, ")
                clauses.append(message if not name or name in message else f"{name}: {message}")
            case _:
                message = problem["msg"][0].lower() + problem["msg"][1:]
                clauses.append(f"{name}: {message}, got {value!r}")
    return "; ".join(clauses)
