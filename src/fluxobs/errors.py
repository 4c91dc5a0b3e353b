"""Errors for unusable input; the command line turns them into exit code 2."""

from __future__ import annotations

import re


class FluxobsError(ValueError):
    """Base of all errors that a user can correct; messages say what is wrong and what to do.

    Messages are written with the flags of the command line; Python's users read the arguments.
    """

    def __str__(self) -> str:
        """Return the message, with quoted file contents shortened."""
        text = super().__str__()
        text = text if len(text) < 4000 else f"{text[:2000]} … {text[-1000:]}"
        return text if _Flags.shown else with_arguments(text)


class MachineError(FluxobsError):
    """A machine's parameters are missing, unknown or impossible."""


class RecordError(FluxobsError):
    """A record, or the description of its channels, is unusable."""


class ObserverError(FluxobsError):
    """An observer setting cannot work."""


class UsageError(FluxobsError, TypeError):
    """Arguments contradict each other, or an argument is missing."""


class ModelError(FluxobsError):
    """A model (relation, immersion, energies, gains, trajectory) is unusable."""


class _Flags:
    """Whether messages name flags."""

    shown = False


def name_flags(shown: bool) -> bool:
    """Set whether messages name the flags of the command line; return the setting before."""
    before, _Flags.shown = _Flags.shown, shown
    return before


#: Arguments that are not called as their flag.
_ARGUMENTS = {"column": "columns", "from": "start", "to": "stop"}
#: A flag, and its value if the message has one: a number, a word of a closed set, KEY=VALUE ….
_FLAG = re.compile(
    r"--([a-z][a-z-]+)"
    r"(?: ([-+]?\d[\d.e+-]*(?=[\s,;)]|$)|alphabeta|abc|line|duty|dq|ports|auto|time|index|none"
    r"|drift(?:,[a-z-]+)*|\w+=[^\s;)]*[^\s;),.](?: \w+=[^\s;)]*[^\s;),.])*))?"
)


def with_arguments(text: str) -> str:
    """Return a message with Python's arguments in place of the flags of the command line.

    Examples
    --------
    >>> with_arguments("give --lag -1, --frame abc --column u_a=A u_b=B or --sample-time")
    "give lag=-1, frame='abc' columns={'u_a': 'A', 'u_b': 'B'} or sample_time"
    """
    return re.sub(_FLAG, _argument, text)


def _argument(flag: re.Match[str]) -> str:
    name = flag[1].replace("-", "_")
    name, value = _ARGUMENTS.get(name, name), flag[2]
    if value is None:
        return name
    if "=" not in value:
        return f"{name}={_literal(value)}"
    pairs = [item.partition("=") for item in value.split(" ")]
    return f"{name}={{{', '.join(f'{key!r}: {_literal(item)}' for key, _, item in pairs)}}}"


def _literal(text: str) -> str:
    try:
        float(text)
    except ValueError:
        return repr(text)
    return text
