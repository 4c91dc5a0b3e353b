"""The forms of an export: what is written around the same C sources, parameters and record."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING

from ...errors import FluxobsError

if TYPE_CHECKING:
    from ..core import Core


@dataclass(frozen=True)
class Form:
    """One form; its module of this package has a function ``files``.

    Attributes
    ----------
    about : str
        For whom, in a line.
    attempt : str
        The command that tries it; ``{folder}`` is the export.
    """

    about: str
    attempt: str


FORMS = {
    "c": Form("a folder of C99 for any firmware", "make -C {folder} test"),
    "arduino": Form(
        "a library for the Arduino IDE and PlatformIO, with a sensor for SimpleFOC",
        "the example SelfTest of {folder}",
    ),
    "fmu": Form("simulation units, FMI 3.0 and 2.0", "python {folder}/test/check.py"),
    "wasm": Form("a WebAssembly module, for browsers and others", "node {folder}/test/check.mjs"),
    "simulink": Form("an S-function as source, untested", "build.m and check.m in {folder}"),
}


def files_of(form: str) -> Callable[[Core], dict[str, str | bytes]]:
    """What writes a form: from a core, relative path → content.

    Raises
    ------
    FluxobsError
        There is no form of this name.
    """
    if form not in FORMS:
        raise FluxobsError(f"no form {form!r} of an export; there are {', '.join(FORMS)}")
    files: Callable[[Core], dict[str, str | bytes]] = import_module(f".{form}", __name__).files
    return files
