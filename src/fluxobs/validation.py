"""Checks of user input: messages name the field, what was given and what would do."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from numbers import Real
from typing import Annotated

from pydantic import Field, ValidationError

from .errors import UsageError

Number = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]


def number(name: str, value: object, unit: str) -> float:
    """Return the value as a float; UsageError if it is not a number."""
    if isinstance(value, bool) or not isinstance(value, Real):
        raise UsageError(f"{name} must be a number [{unit}], got {value!r}")
    return float(value)


def nearest(word: str, known: Iterable[str]) -> str:
    """Suggest the known name that is probably meant, or list all of them."""
    known = list(known)
    close = difflib.get_close_matches(word, known, n=1, cutoff=0.5)
    return f"; did you mean {close[0]!r}?" if close else f"; known: {', '.join(known)}"


def complaints(error: ValidationError, fields: Iterable[str], what: str) -> str:
    """One clause per problem. `what` needs the fields: "kind surface-pmsm", for example."""
    fields = list(fields)
    out = []
    for problem in error.errors():
        name = ".".join(str(part) for part in problem["loc"])
        given = problem.get("input")
        match problem["type"]:
            case "missing":
                out.append(f"{name} is missing: {what} needs it")
            case "extra_forbidden":
                out.append(f"unknown field {name!r}{nearest(name, fields)}")
            case "greater_than":
                out.append(f"{name} must be positive, got {given}")
            case "value_error":
                message = problem["msg"].removeprefix("Value error, ")
                out.append(f"{name}: {message}" if "." in name else message)
            case _:
                message = problem["msg"][0].lower() + problem["msg"][1:]
                out.append(f"{name}: {message}, got {given!r}")
    return "; ".join(out)
