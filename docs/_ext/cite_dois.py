"""Links the DOIs of docstrings and pages to the bibliography (references.bib).

A docstring names its source in full, with its DOI. The site turns ``doi:10.…`` into a citation of
the entry with this DOI. A DOI without an entry stops the build.
"""

from __future__ import annotations

import re
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.errors import ExtensionError

DOI = re.compile(r"doi:(10\.\d{4,}/[^\s,;`\"']*[^\s,;`\"'.):])")
FIELD = re.compile(r"^@\w+\{(?P<key>\w+),.*?doi = \{(?P<doi>[^}]+)\}", re.DOTALL | re.MULTILINE)


def entries() -> dict[str, str]:
    """Return DOI → key of the bibliography."""
    text = (Path(__file__).parents[1] / "references.bib").read_text(encoding="utf-8")
    return {
        match["doi"]: match["key"]
        for entry in re.split(r"(?m)^(?=@)", text)
        if (match := FIELD.search(entry))
    }


def cited(text: str, role: str, keys: dict[str, str]) -> str:
    """Replace DOIs by citations; `role` is that of reStructuredText or of Markdown."""

    def citation(match: re.Match[str]) -> str:
        if match[1] not in keys:
            raise ExtensionError(f"references.bib has no entry with doi {match[1]}")
        return role.format(keys[match[1]])

    return DOI.sub(citation, text)


def setup(app: Sphinx) -> dict[str, bool]:
    keys = entries()

    def in_docstring(*arguments: object) -> None:
        lines = arguments[-1]
        assert isinstance(lines, list)
        lines[:] = [cited(line, ":cite:p:`{}`", keys) for line in lines]

    def in_page(_app: Sphinx, _name: str, source: list[str]) -> None:
        source[0] = cited(source[0], "{{cite:p}}`{}`", keys)

    app.connect("autodoc-process-docstring", in_docstring, priority=800)
    app.connect("source-read", in_page)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
