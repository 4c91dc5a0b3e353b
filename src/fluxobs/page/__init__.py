"""The page and reports: self-contained HTML files that compute in the browser.

`make page` builds both from `web/` in the project's root, from the package's modules in JavaScript,
and from the firmware's source in WebAssembly.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..errors import FluxobsError

_FOLDER = Path(__file__).parent
#: Placeholders for the data of a report.
_DATA, _BLOCKS = "{{data}}", "{{blocks}}"


def built(name: str) -> str:
    """Return the text of a file built by `make page`, "page.html" or "report.html".

    Raises
    ------
    FluxobsError
        The file is missing: the installation is editable, and `make page` has not been run.
    """
    path = _FOLDER / name
    if not path.is_file():
        raise FluxobsError(
            f"{name} is missing: this installation is editable. Run `make page`, or `pip install "
            f"--group page` and `python web/build.py`, in {_FOLDER.parents[2]}"
        )
    return path.read_text(encoding="utf-8")


def with_data(template: str, data: Mapping[str, Any]) -> str:
    """Return a template filled with data for its script.

    Parameters
    ----------
    template : str
    data : mapping
        Data for JSON. Texts under a key "data" are moved, one after the other, into a separate
        block and replaced by [first, length].
    """
    blocks: list[str] = []
    text = in_script(_extract_blocks(data, blocks))
    # Search the template only: a name in the data may look like a placeholder.
    before, _, rest = template.partition(_DATA)
    between, _, after = rest.partition(_BLOCKS)
    return "".join([before, text, between, *blocks, after])


def in_script(data: Any) -> str:
    """Return data as JSON for a script element.

    The JSON contains no "<", so that it cannot end the element or begin a comment.
    """
    text = json.dumps(data, ensure_ascii=False, allow_nan=False)
    # Escape lone surrogates, which file names may contain: UTF-8 cannot encode them.
    text = text.encode(errors="backslashreplace").decode()
    return text.replace("<", "\\u003c")


def _extract_blocks(data: Any, blocks: list[str]) -> Any:
    """Return the data with the texts under "data" moved to `blocks`."""
    if isinstance(data, Mapping):
        return {name: _extract_value(name, value, blocks) for name, value in data.items()}
    return [_extract_blocks(item, blocks) for item in data] if isinstance(data, list) else data


def _extract_value(name: str, value: Any, blocks: list[str]) -> Any:
    if name != "data" or not isinstance(value, str):
        return _extract_blocks(value, blocks)
    blocks.append(value)
    return [sum(map(len, blocks[:-1])), len(value)]
