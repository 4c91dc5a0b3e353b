"""Forms of an export, which all contain the same C sources, parameters and record."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING

from ...errors import FluxobsError

if TYPE_CHECKING:
    from ..core import Core


#: Command or place that tests an export in ``{folder}``, by form. Each form is a module of this
#: package with a function ``files``.
FORMS = {
    "c": "make -C {folder} test",
    "arduino": "the example SelfTest of {folder}",
    "fmu": "python {folder}/test/check.py",
    "wasm": "node {folder}/test/check.mjs",
    "rust": "cargo test --manifest-path {folder}/Cargo.toml",
}


def files_of(form: str) -> Callable[[Core], dict[str, str | bytes]]:
    """Return the function that turns a core into the files of a form, by relative path.

    Raises
    ------
    FluxobsError
        No form has this name.
    """
    if form not in FORMS:
        raise FluxobsError(f"no form {form!r} of an export; choose one of {', '.join(FORMS)}")
    files: Callable[[Core], dict[str, str | bytes]] = import_module(f".{form}", __name__).files
    return files
