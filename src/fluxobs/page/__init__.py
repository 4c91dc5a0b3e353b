"""The page, and reports: HTML files that need nothing else, and compute in the browser.

Both are built from `web/` in the project's root (`make page`): the package's own modules in
JavaScript, and the firmware's source in WebAssembly.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..errors import FluxobsError

_FOLDER = Path(__file__).parent
#: Where the data of a report goes.
_DATA, _BLOCKS = "{{data}}", "{{blocks}}"


def built(name: str) -> str:
    """The text of a file that `make page` has built, "page.html" or "report.html".

    Raises
    ------
    FluxobsError
        It is not there: an editable installation, before `make page`.
    """
    path = _FOLDER / name
    if not path.is_file():
        raise FluxobsError(
            f"{name} is missing: this installation is editable. Run `make page`, or `pip install "
            f"--group page` and `python web/build.py`, in {_FOLDER.parents[2]}"
        )
    return path.read_text(encoding="utf-8")


def with_data(template: str, data: Mapping[str, Any]) -> str:
    """A template with its data, for a script in it to read.

    Parameters
    ----------
    template : str
    data : mapping
        What JSON can hold. Texts under a key "data" go into a block of their own, one after the
        other; (first, length) stands in their place.
    """
    blocks: list[str] = []
    text = in_script(_apart(data, blocks))
    # each mark is looked for in the template alone: a name in the data may be such a mark
    before, _, rest = template.partition(_DATA)
    between, _, after = rest.partition(_BLOCKS)
    return "".join([before, text, between, *blocks, after])


def in_script(data: Any) -> str:
    """Data as JSON for a script element. It has no "<", so that nothing in it can end the element
    or begin a comment."""
    text = json.dumps(data, ensure_ascii=False, allow_nan=False)
    # halves of characters, as the name of a file may have, are escaped: no page can hold them
    text = text.encode(errors="backslashreplace").decode()
    return text.replace("<", "\\u003c")


def _apart(data: Any, blocks: list[str]) -> Any:
    """The same, with its long texts moved to `blocks`."""
    if isinstance(data, Mapping):
        return {name: _moved(name, value, blocks) for name, value in data.items()}
    return [_apart(one, blocks) for one in data] if isinstance(data, list) else data


def _moved(name: str, value: Any, blocks: list[str]) -> Any:
    if name != "data" or not isinstance(value, str):
        return _apart(value, blocks)
    blocks.append(value)
    return [sum(map(len, blocks[:-1])), len(value)]
