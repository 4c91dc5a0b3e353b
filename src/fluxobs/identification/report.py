"""An identification in words, as a machine file, and as a picture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from .identify import Identification

ADVICE = (
    "Record one with steps of load at several speeds, a run-up from rest, or both directions: a "
    "resistance acts with the current, an inverter with its sign, a magnet with the speed"
)


def lines(found: Identification) -> list[str]:
    """A parameter a line, then what the log cannot tell, then the residual."""
    out = []
    for p in found.parameters:
        was = "not given" if p.given is None else f"given {p.given:.4g}"
        if p.std is None:
            out.append(f"{p.name} held at {p.value:.4g} {p.unit}: {found.untold[p.name]}")
        else:
            out.append(f"{p.name} = {p.value:.4g} ± {p.std:.2g} {p.unit} ({was})")
    if found.untold:
        out.append(
            f"This log cannot tell {', '.join(found.untold)}; what it tells holds if these are as "
            f"given. {ADVICE}."
        )
    size = found.after.values["psi_f"] or np.mean([np.linalg.norm(p.start) for p in found.pieces])
    out.append(
        f"Residual of the relation: {found.before.rms() / size:.2%} of the flux as given, "
        f"{found.after.rms() / size:.2%} as found"
    )
    if not found.after.converged:
        out.append("Warning: the fit did not settle; treat its values with caution")
    return out


def toml(found: Identification, log: Path) -> str:
    """The machine file."""
    stds = {"inverter_voltage" if p.name == "inverter" else p.name: p.std for p in found.parameters}
    rows = [
        f"# Identified from {log.name} by `fluxobs identify`.",
        f'kind = "{found.machine.kind}"',
    ]
    for name, value in found.machine.model_dump(by_alias=True, exclude_none=True).items():
        std = stds.get(name)
        rows.append(f"{name} = {value!r}" + (f"  # ± {std:.2g}" if std is not None else ""))
    return "\n".join(rows) + "\n"


def draw(found: Identification, path: Path) -> None:
    """Residual over time, before and after; .png, .pdf or .svg."""
    import matplotlib as mpl

    mpl.use("agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(9, 4.5), layout="constrained")
    size = found.after.values["psi_f"] or float(
        np.mean([np.linalg.norm(p.start) for p in found.pieces])
    )
    styles: tuple[tuple[Any, str, str], ...] = (
        (found.before, "as given", "tab:orange"),
        (found.after, "as identified", "tab:blue"),
    )
    for fitted, label, colour in styles:
        begin = 0.0
        for k, (piece, residual) in enumerate(zip(found.pieces, fitted.residuals, strict=True)):
            axes.plot(
                begin + piece.t,
                100 * residual / size,
                color=colour,
                linewidth=0.8,
                label=f"{label}: {100 * fitted.rms() / size:.2f} % rms" if k == 0 else None,
            )
            begin += float(piece.t[-1])
    axes.set_xlabel("time in the pieces that were used [s]")
    axes.set_ylabel("residual of the relation [% of the flux]")
    axes.grid(alpha=0.3)
    axes.legend(loc="upper right")
    axes.set_title("How well the machine's relation holds over the log")
    figure.savefig(path, dpi=120)
    plt.close(figure)
