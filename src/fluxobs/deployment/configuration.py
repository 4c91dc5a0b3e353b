"""Configuration in C from which the parameters were computed; fo_retune changes a copy of it."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..observers import AdaptiveObserver
from .header import Exported, plain


def configuration_files(prefix: str, observer: Exported) -> dict[str, str]:
    """Return the texts of header and source, by file name."""
    adaptive = isinstance(observer, AdaptiveObserver)
    include = "fluxobs_adaptive.h" if adaptive else "fluxobs.h"
    fields = dict(plain(observer).configuration())
    declared = [f"extern const fo_config {prefix}_config;"]
    defined = [_struct("fo_config", f"{prefix}_config", fields)]
    if isinstance(observer, AdaptiveObserver):
        more = observer.configuration()
        more["projection"] = f"FO_PROJECT_{observer.projection.upper()}"
        declared.append(f"extern const fo_adaptive_config {prefix}_adaptive_config;")
        defined.append(_struct("fo_adaptive_config", f"{prefix}_adaptive_config", more))
    guard = f"{prefix}_config_h"  # include guards of the library end in a capital letter
    about = (
        f"/* Configuration of {prefix} in SI units: fo_init computes the parameters from it. */\n"
    )
    lines = "\n".join(declared)
    header = (
        f'{about}#ifndef {guard}\n#define {guard}\n\n#include "{include}"\n\n'
        f'#ifdef __cplusplus\nextern "C" {{\n#endif\n\n{lines}\n\n'
        f"#ifdef __cplusplus\n}}\n#endif\n\n#endif\n"
    )
    source = f'{about}#include "{prefix}_config.h"\n\n' + "\n\n".join(defined) + "\n"
    return {f"{prefix}_config.h": header, f"{prefix}_config.c": source}


def _struct(kind: str, name: str, fields: dict[str, Any]) -> str:
    rows = "\n".join(f"    .{field} = {_value(value)}," for field, value in fields.items())
    return f"const {kind} {name} = {{\n{rows}\n}};"


def _value(value: Any) -> str:
    if isinstance(value, str):
        return value
    if np.ndim(value):
        return "{" + ", ".join(_value(element) for element in value) + "}"
    return f"(fo_real){float(value)!r}"
