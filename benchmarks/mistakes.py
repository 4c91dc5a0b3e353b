"""How often `check` is silent on a correct log, and finds the mistake in a wrong log.

Random drives of eight machines (random_drives.py) with inverters and offsets. In a log with a
mistake, R also has errors up to 50 % and the magnet flux up to 20 %.

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


#: Mistake → (change of the log or machine, text expected in a finding or alternative).
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


def columns_of(record: Drive) -> Columns:
    u, i = record.voltage, record.current
    u = np.concatenate([u[1:], u[-1:]])
    names = ("u_alpha", "u_beta", "i_alpha", "i_beta")
    return dict(zip(names, (u.real, u.imag, i.real, i.imag), strict=True))


def attempt(job: tuple[str, int]) -> list[tuple[str, str, str]]:
    """Return (name, verdict, text of the findings) for each mistake."""
    record, verdicts = simulate(*job, 0.25), []
    for name, (change, expected) in MISTAKES.items():
        if name.startswith("psi_f") and not record.machine.magnets:
            continue
        columns, machine = change(
            columns_of(record), record.believed if expected else record.machine
        )
        findings = check(columns, machine, sample_time=record.sample_time)
        text = "; ".join(str(finding) for finding in findings.mistakes)
        if not expected:
            verdict = "named" if findings.sound else "else"
        else:
            verdict = "silent" if findings.sound else "named" if expected in text else "else"
            if findings.sound and any(
                expected in other for f in findings.findings for other in f.others
            ):
                verdict = "cannot tell"
        verdicts.append((name, verdict, f"{job}: {text}"))
    return verdicts


def main(drives: int, print_texts: bool) -> None:
    heading(
        f"check on {drives} random drives of each machine: number of logs on which check is "
        "correct (names the mistake, perhaps among others), ambiguous, silent, or wrong"
    )
    jobs = [(name, seed) for name in MACHINES for seed in range(drives)]
    with ProcessPoolExecutor() as pool:
        verdicts = [result for results in pool.map(attempt, jobs) for result in results]
    for mistake in MISTAKES:
        of_mistake = [(verdict, text) for name, verdict, text in verdicts if name == mistake]
        counts = [
            sum(verdict == kind for kind, _ in of_mistake)
            for verdict in ("named", "cannot tell", "silent", "else")
        ]
        print(f"    {mistake:16s} {counts[0]:3d} {counts[1]:3d} {counts[2]:3d} {counts[3]:3d}")
        if print_texts:
            for verdict, text in of_mistake:
                if verdict in ("else", "silent"):
                    print(f"        {verdict} {text}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--drives", type=int, default=3)
    parser.add_argument("--tell", action="store_true", help="print the other findings")
    options = parser.parse_args()
    main(options.drives, options.tell)
