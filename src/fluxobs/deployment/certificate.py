"""Certificate of an export: hashes of its contents, and the comparisons made."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from .c_source import Precision
from .core import Core
from .folder import sha256
from .header import parameters, settings
from .vectors import COLUMNS, expected, inputs


def certificate(core: Core, form: str, check: str, compared: Sequence[dict[str, Any]] = ()) -> str:
    """Return the text of certificate.json.

    Parameters
    ----------
    core : Core
    form : str
        Form of the export.
    check : str
        Command that compares the export with the expected outputs.
    compared : sequence of dict
        Comparisons made during the export. Each names both sides, the rows and the differing rows.
    """
    samples = inputs(core.record)
    kinds: dict[Precision, str] = {"single": "<f4", "double": "<f8"}
    outputs = {
        name: {
            "sha256": sha256(expected(core.estimates[name]).astype(kind).tobytes()),
            "valid": int(core.estimates[name].valid.sum()),
        }
        for name, kind in kinds.items()
    }
    facts = {
        "made_by": f"fluxobs {core.version}",
        "form": form,
        "prefix": core.prefix,
        "content": core.content,
        "machine": parameters(core.machine),
        "settings": settings(core.single, core.update_every),
        "sources": {name: sha256(text.encode()) for name, text in core.sources.items()},
        "parameters": {name: sha256(text.encode()) for name, text in core.parameters.items()},
        "record": {
            "rows": len(samples),
            "columns": ["u_alpha [V]", "u_beta [V]", "i_alpha [A]", "i_beta [A]"],
            "sha256": sha256(np.asarray(samples, "<f8").tobytes()),
        },
        "expected": {
            "by": f"the compiled observers of fluxobs {core.version}, built from these sources",
            "columns": list(COLUMNS),
            "precisions": outputs,
        },
        "compared": list(compared),
        "check": check,
    }
    return json.dumps(facts, indent=1) + "\n"
