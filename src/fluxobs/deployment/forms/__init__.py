"""The forms of an export: what is written around the same C sources, parameters and record."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING

from ...errors import FluxobsError

if TYPE_CHECKING:
    from ..core import Core


#: Form → the command, or the place, that tries an export in ``{folder}``. Each form is a module of
#: this package with a function ``files``.
FORMS = {
    "c": "make -C {folder} test",
    "arduino": "the example SelfTest of {folder}",
    "fmu": "python {folder}/test/check.py",
    "wasm": "node {folder}/test/check.mjs",
    "rust": "cargo test --manifest-path {folder}/Cargo.toml",
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
