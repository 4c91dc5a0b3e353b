"""Comparison of an identification with its stored output."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fluxobs.identification import Identification
from fluxobs.identification.report import html_of

from .expected import check

PICTURE = "data:image/png"


def check_identification(name: str, identification: Identification, folder: Path) -> None:
    """Compare lines, page, facts, picture, fit and map with tests/expected/identification/NAME."""
    page, _, rest = html_of(identification).partition(PICTURE)
    output = {
        "lines": identification.lines(),
        "page": page,
        "alt": rest.partition("alt=")[2],
        "facts": identification.facts,
        "picture": identification.plot(),
    }
    if identification.segment_fit is not None:
        after = identification.segment_fit.after
        output["values"] = {name: float(value) for name, value in after.values.items()}
        stds = np.sqrt(np.diag(after.covariance))
        output["std"] = dict(zip(after.free, stds, strict=True))
        output["alike"] = after.alike
    if identification.map is not None:
        identification.write(folder / "map.csv")
        output["table"] = (folder / "map.csv").read_text().splitlines()[::7]
    # The iteration ends at a small share of the deviations; rounding differs between computers.
    check(f"identification/{name}", output, share=1e-3)
