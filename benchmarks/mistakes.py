"""How often `check` is silent on a right log, and names the mistake on a wrong one.

Random drives of eight machines (random_drives.py), with inverters and offsets, and for the mistakes
with R off by up to a half and the magnet by a fifth besides.

    python benchmarks/mistakes.py [--drives 3]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor

import numpy as np
from common import heading
from random_drives import MACHINES, Drive, simulate

from fluxobs import check
from fluxobs.machines import RotatingMachine

Columns = dict[str, np.ndarray]


def _turned(columns: Columns, mirrored: bool, degrees: float) -> Columns:
    z = columns["i_alpha"] + 1j * columns["i_beta"]
    z = np.exp(1j * np.radians(degrees)) * (z.conj() if mirrored else z)
    return columns | {"i_alpha": z.real, "i_beta": z.imag}


def _scaled(columns: Columns, letter: str, factor: float) -> Columns:
    return {name: factor * x if name[0] == letter else x for name, x in columns.items()}


def _file(**factors: float) -> Callable[[Columns, RotatingMachine], tuple]:
    def change(columns: Columns, machine: RotatingMachine) -> tuple:
        return columns, machine.with_values(
            **{k: f * getattr(machine, k) for k, f in factors.items() if hasattr(machine, k)}
        )

    return change


def _log(change: Callable[[Columns], Columns]) -> Callable[[Columns, RotatingMachine], tuple]:
    return lambda columns, machine: (change(columns), machine)


#: Mistake -> what it does, and what a finding or one of its alternatives has to say.
MISTAKES = {
    "none": (lambda columns, machine: (columns, machine), ""),
    "sign": (_log(lambda c: _scaled(c, "i", -1)), "opposite sign"),
    "b, c exchanged": (_log(lambda c: _turned(c, True, 0)), "b and c are exchanged"),
    "shifted": (_log(lambda c: _turned(c, False, 120)), "shifted by one"),
    "psi_f x 4": (_file(psi_f=4.0), "psi_f in the machine file"),
    "psi_f / 10": (_file(psi_f=0.1), "psi_f in the machine file"),
    "L in mH": (_file(L_s=1000.0, L_d=1000.0, L_q=1000.0), "inductances in the machine file"),
    "currents in mA": (_log(lambda c: _scaled(c, "i", 1000)), "scale of the currents"),
    "line voltages": (_log(lambda c: _scaled(c, "u", np.sqrt(3))), "line to line"),
}


def columns_of(one: Drive) -> Columns:
    u, i = one.voltage, one.current
    u = np.concatenate([u[1:], u[-1:]])
    names = ("u_alpha", "u_beta", "i_alpha", "i_beta")
    return dict(zip(names, (u.real, u.imag, i.real, i.imag), strict=True))


def attempt(job: tuple[str, int]) -> list[tuple[str, str, str]]:
    """Mistake, verdict, and what was said, for each of the mistakes."""
    one, out = simulate(*job, 0.25), []
    for name, (change, words) in MISTAKES.items():
        if name.startswith("psi_f") and not one.machine.magnets:
            continue
        columns, machine = change(columns_of(one), one.believed if words else one.machine)
        found = check(columns, machine, sample_time=one.sample_time)
        said = "; ".join(str(finding) for finding in found.mistakes)
        if not words:
            verdict = "named" if found.sound else "else"
        else:
            verdict = "silent" if found.sound else "named" if words in said else "else"
            if found.sound and any(words in w for f in found.findings for w in f.others):
                verdict = "cannot tell"
        out.append((name, verdict, f"{job}: {said}"))
    return out


def main(drives: int, tell: bool) -> None:
    heading(
        f"check on {drives} random drives of each machine: right (of the mistake: named, perhaps "
        "with others), cannot tell, silent, something else"
    )
    jobs = [(name, seed) for name in MACHINES for seed in range(drives)]
    with ProcessPoolExecutor() as pool:
        found = [one for part in pool.map(attempt, jobs) for one in part]
    for mistake in MISTAKES:
        mine = [(verdict, said) for name, verdict, said in found if name == mistake]
        counts = [
            sum(verdict == v for v, _ in mine)
            for verdict in ("named", "cannot tell", "silent", "else")
        ]
        print(f"    {mistake:16s} {counts[0]:3d} {counts[1]:3d} {counts[2]:3d} {counts[3]:3d}")
        if tell:
            for verdict, said in mine:
                if verdict in ("else", "silent"):
                    print(f"        {verdict} {said}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--drives", type=int, default=3)
    parser.add_argument("--tell", action="store_true", help="print what was said instead")
    options = parser.parse_args()
    main(options.drives, options.tell)
