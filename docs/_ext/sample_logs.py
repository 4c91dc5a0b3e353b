"""Write the shipped log in the layouts of real logs, for the commands on the pages."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fluxobs.simulation.closed_form.demo import LOG

EXAMPLES = Path(__file__).parents[2] / "examples"

MOTOR = """\
kind = "surface-pmsm"
R_s = 0.36
L_s = 0.6e-3
n_p = 4
psi_f = 0.0125
rated_current = 12.0
"""


def _csv(path: Path, delimiter: str = ",", comma: bool = False, **columns: np.ndarray) -> None:
    rows = [delimiter.join(columns)]
    for row in zip(*columns.values(), strict=True):
        cells = delimiter.join("" if np.isnan(v) else f"{v:.7g}" for v in row)
        rows.append(cells.replace(".", ",") if comma else cells)
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")


def write_samples(folder: Path) -> None:
    """Write log.csv and motor.toml of the README, a file with a wrong R_s, and other layouts."""
    text = LOG.read_text(encoding="utf-8")
    (folder / "log.csv").write_text(text, encoding="utf-8")
    (folder / "motor.toml").write_text(MOTOR, encoding="utf-8")
    campaign = (EXAMPLES / "campaigns" / "small.toml").read_text(encoding="utf-8")
    (folder / "small.toml").write_text(campaign, encoding="utf-8")
    guess = MOTOR.replace("0.36", "0.45")
    (folder / "guess.toml").write_text(guess, encoding="utf-8")
    table = np.genfromtxt(text.splitlines(), delimiter=",", names=True)
    t, theta = table["t"], table["theta_e"]
    turn = np.exp(1j * np.radians([0, -120, 120]))
    u, i = table["u_alpha"] + 1j * table["u_beta"], table["i_alpha"] + 1j * table["i_beta"]
    ua, ub, uc = ((u * k).real for k in turn)
    ia, ib, ic = ((i * k).real for k in turn)
    mechanical = np.unwrap(theta) / 4
    _csv(
        folder / "drive.csv",
        ";",
        comma=True,
        **{
            "time [ms]": 1e3 * t,
            "Ua [V]": ua,
            "Ub [V]": ub,
            "Uc [V]": uc,
            "Ia [mA]": 1e3 * ia,
            "Ib [mA]": 1e3 * ib,
            "encoder [deg]": np.degrees(np.mod(mechanical + 0.35, 2 * np.pi)),
        },
    )
    _csv(
        folder / "bare.csv",
        ";",
        A0=1e3 * t,
        A1=ua,
        A2=ub,
        A3=uc,
        A4=np.round(2048 + 40.96 * ia),
        A5=np.round(2048 + 40.96 * ib),
    )
    scope = [f"{a:.7e}" for a in (t - 1.0)]
    values = zip(scope, ia, ib, ua - ub, ub - uc, strict=True)
    rows = ["x-axis,1,2,3,4", "second,Ampere,Ampere,Volt,Volt"]
    rows += [f"{at},{a:.5f},{b:.5f},{c:.5f},{d:.5f}" for at, a, b, c, d in values]
    (folder / "scope.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    _csv(folder / "currents.csv", t=t, i_a=ia, i_b=ib)
    _csv(folder / "voltages.csv", t=t + 0.0131, u_a=ua, u_b=ub, u_c=uc, i_a=ia)
    _csv(folder / "line.csv", t=t, u_ab=ua - ub, u_bc=ub - uc, i_a=ia, i_b=ib, i_c=ic)
    udc = 48.0
    _csv(
        folder / "duty.csv",
        t=t,
        d_a=0.5 + ua / udc,
        d_b=0.5 + ub / udc,
        d_c=0.5 + uc / udc,
        i_a=ia,
        i_b=ib,
    )
    # A dq controller transforms the voltage with the angle in the middle of its interval.
    after = np.append(np.unwrap(theta)[1:], 2 * np.unwrap(theta)[-1] - np.unwrap(theta)[-2])
    middle = (np.unwrap(theta) + after) / 2
    dq, idq = u * np.exp(-1j * middle), i * np.exp(-1j * theta)
    _csv(
        folder / "dq.csv", t=t, u_d=dq.real, u_q=dq.imag, i_d=idq.real, i_q=idq.imag, theta_e=theta
    )
    names = ("u_alpha", "u_beta", "i_alpha", "i_beta")
    _csv(folder / "untimed.csv", **{name: table[name] for name in names})
    gaps = {name: table[name].copy() for name in names}
    for name in names:
        gaps[name][[2000, 2001, 5000]] = np.nan
    _csv(folder / "gaps.csv", t=t, **gaps)
    keep = np.ones(len(t), bool)
    keep[3000:3040] = keep[7000] = False
    _csv(folder / "lost.csv", t=t[keep], **{name: table[name][keep] for name in names})
