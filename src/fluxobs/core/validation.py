"""Checks of user input: messages name the field, what was given and what would do."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from numbers import Real
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from ..errors import UsageError

Number = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class Table(BaseModel):
    """A table of a file that users write: frozen, and a misspelt key is an error that suggests."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    @model_validator(mode="before")
    @classmethod
    def _known(cls, given: Any) -> Any:
        if isinstance(given, Mapping):
            for name in given:
                if name not in cls.model_fields:
                    raise ValueError(f"unknown field {name!r}{nearest(name, cls.model_fields)}")
        return given


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
                out.append(message if not name or name in message else f"{name}: {message}")
            case _:
                message = problem["msg"][0].lower() + problem["msg"][1:]
                out.append(f"{name}: {message}, got {given!r}")
    return "; ".join(out)
