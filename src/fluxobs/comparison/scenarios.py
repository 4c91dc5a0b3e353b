"""The shipped scenarios.

A drive with an encoder is simulated; all observers then run on the same record.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from ..errors import ModelError
from ..machines import RotatingMachine, example, rotating
from ..simulation.drive import (
    Course,
    Inverter,
    Profile,
    Rating,
    Run,
    encoder_drive,
    rating,
    simulate,
)

#: Current noise of all scenarios except the ideal one, as a share of the rated current.
NOISE = 1 / 300


#: Share of the rated current at which the smoothed sign of the simulated inverter reaches three
#: quarters; intentionally sharper than the 5 % that observers assume (machines/model/inverter.py).
KNEE = 0.02


@dataclass(frozen=True)
class Scenario:
    """A record to simulate.

    Attributes
    ----------
    name, about : str
    speed, load : tuple of (time [s], share of the rated value)
    duration, score_from : float
        Length of the record, start of scoring [s].
    current_offset, voltage_offset : tuple of (time, α share, β share)
        Shares of the rated current, and of the rated voltage ω ψ.
    noise : float
        Std as a share of the rated current.
    believed : dict
        Factors on the parameters that the observers assume: R, L, psi.
    theta_e : float
        Initial angle of the rotor [rad].
    limit : str
        Phrase that names the limitation of the least squares here, besides noise.
    other : dict
        dead_time [share of a sample], drop [share of dc_link], dc_link (profile of shares),
        gain, range [share of rated current].
    """

    name: str
    about: str
    speed: tuple[tuple[float, float], ...] = (
        (0.0, 0.0),
        (0.3, 0.5),
        (0.8, 0.5),
        (1.2, 1.0),
        (1.7, 1.0),
        (2.3, -0.3),
    )
    load: tuple[tuple[float, float], ...] = ((0.6, 0.0), (0.6, 1.0))
    duration: float = 3.0
    score_from: float = 0.5
    current_offset: tuple[tuple[float, float, float], ...] = ((0.0, 0.0, 0.0),)
    voltage_offset: tuple[tuple[float, float, float], ...] = ((0.0, 0.0, 0.0),)
    noise: float = NOISE
    believed: dict[str, float] = field(default_factory=dict)
    theta_e: float = 1.0
    limit: str = ""
    other: dict[str, Any] = field(default_factory=dict)


RESISTANCE = (
    "the error of a wrong R rotates with the rotor: it causes a residual only while load or speed "
    "change, and then resembles a drift; at low speed the angle error is (R - R') i/(ω ψ)"
)
INDUCTANCE = "a wrong L rotates x = λ - L i by (L - L') i_q/ψ at once, which no observer can detect"


def _define_scenarios() -> dict[str, Scenario]:
    scenarios = [Scenario("ideal", "no bias, no noise, all parameters correct", noise=0.0)]

    def add(name: str, about: str, **fields: Any) -> None:
        scenarios.append(Scenario(name, about, **fields))

    add("noise", "current noise of 1/300 of rated")
    for sign, suffix in ((1, "plus"), (-1, "minus")):
        add(
            f"current-bias-{suffix}",
            f"current offset of {5 * sign:+d} % of rated",
            current_offset=((0.0, 0.05 * 0.6 * sign, 0.05 * 0.8 * sign),),
        )
    for sign, suffix in ((1, "plus"), (-1, "minus")):
        add(
            f"voltage-bias-{suffix}",
            f"voltage offset of {2 * sign:+d} % of rated",
            voltage_offset=((0.0, 0.02 * 0.8 * sign, -0.02 * 0.6 * sign),),
        )
    add(
        "both-biases",
        "offsets of 0.036 of rated current and 0.0086 of rated voltage",
        current_offset=((0.0, 0.036 * 0.6, 0.036 * 0.8),),
        voltage_offset=((0.0, 0.0086, 0.0),),
    )
    add(
        "bias-drifts",
        "current offset from 0 to 5 % of rated within 2 s",
        current_offset=((0.5, 0.0, 0.0), (2.5, 0.03, 0.04)),
        limit="the memory averages the changing drift",
    )
    add(
        "bias-jumps",
        "current offset of 2 % and voltage offset of 0.5 % change sign at 2.6 s",
        current_offset=((0.0, 0.02, 0.0), (2.6, 0.02, 0.0), (2.6, -0.02, 0.0)),
        voltage_offset=((0.0, 0.0, 0.005), (2.6, 0.0, 0.005), (2.6, 0.0, -0.005)),
        limit="samples from before the jump count until they are forgotten",
    )
    for name, factors, limit in (
        ("R", (0.5, 0.8, 1.2, 1.5), RESISTANCE),
        ("L", (0.8, 1.2), INDUCTANCE),
        ("psi", (0.8, 1.2), ""),
    ):
        for factor in factors:
            add(
                f"{name}-{round(100 * factor)}",
                f"the observers assume {factor:g} times the true {name}",
                believed={name: factor},
                limit=limit,
            )
    add(
        "dead-time",
        "dead time of 1/60 of a sample and device drops of 0.2 % of the DC link, not compensated",
        load=((0.6, 0.0), (0.6, 0.6)),
        other={"dead_time": 1 / 60, "drop": 0.002},
        limit="the inverter's voltage error rotates with the current; near zero speed it exceeds "
        "the EMF",
    )
    add(
        "low-speed-10",
        "10 % of rated speed, load step, reversal",
        speed=((0.0, 0.0), (0.2, 0.1), (1.8, 0.1), (2.2, -0.1)),
        load=((1.2, 0.0), (1.2, 1.0)),
        limit="with unknown drift only the rotation of the flux carries information; a filter that "
        "knows psi and assumes zero drift has more information",
    )
    add(
        "low-speed-1",
        "1 % of rated speed, load step, no bias",
        speed=((0.0, 0.0), (0.2, 0.01)),
        load=((5.0, 0.0), (5.0, 1.0)),
        limit="a memory of 1 s covers 0.75 turns here; a filter that assumes zero drift has more "
        "information",
        duration=9.0,
        score_from=3.0,
    )
    add(
        "load-step",
        "full load on and off at half speed",
        speed=((0.0, 0.0), (0.3, 0.5)),
        load=((0.8, 0.0), (0.8, 1.0), (1.6, 1.0), (1.6, 0.0), (2.2, 0.0), (2.2, -1.0)),
    )
    add(
        "reversal",
        "two reversals between plus and minus half speed under half load",
        speed=((0.0, 0.0), (0.3, 0.5), (0.8, 0.5), (1.3, -0.5), (1.8, -0.5), (2.3, 0.5)),
        load=((0.4, 0.0), (0.4, 0.5)),
    )
    add(
        "unknown-start",
        "start from standstill, 2.8 rad from the observers' initial angle; scored from 0.1 s",
        speed=((0.0, 0.0), (0.05, 0.0), (0.25, 0.5)),
        load=((0.6, 0.0), (0.6, 1.0)),
        theta_e=2.8,
        limit="initially flux and drift are unknown; the first half turn separates them",
        duration=1.5,
        score_from=0.1,
    )
    add(
        "dc-link-sag",
        "measured DC link sags to 60 % for 0.3 s at full speed and half load",
        load=((0.6, 0.0), (0.6, 0.5)),
        other={"dc_link": ((1.3, 1.0), (1.31, 0.6), (1.6, 0.6), (1.61, 1.0))},
    )
    add(
        "gain-mismatch",
        "phase current sensors with gains 1.02, 0.98 and 1",
        other={"gain": (1.02, 0.98, 1.0)},
        limit="unequal gains make L i an ellipse: the error has twice the frequency and is partly "
        "estimated as a drift",
    )
    add(
        "sensor-saturation",
        "current sensors clip at the rated current; load and acceleration need 1.1 times this",
        other={"range": 1.0},
        limit="clipping adds L times the missing current to x = λ - L i",
    )
    return {scenario.name: scenario for scenario in scenarios}


SCENARIOS = _define_scenarios()


def scenario(name: str) -> Scenario:
    """Return a scenario by name.

    Raises
    ------
    ModelError
        Unknown name; the message lists all scenarios.
    """
    if name not in SCENARIOS:
        raise ModelError(f"no scenario {name!r}; there are {', '.join(SCENARIOS)}")
    return SCENARIOS[name]


def believed_machine(machine: RotatingMachine, factors: dict[str, float]) -> RotatingMachine:
    """Return the machine that the observers assume."""
    parameters = {"R": ("R_s",), "L": machine.inductance_names, "psi": (machine.flux_name,)}
    for key, factor in factors.items():
        machine = machine.scaled(parameters[key], factor)
    return machine


def run_scenario(
    chosen: Scenario, machine_name: str, seed: int = 0
) -> tuple[Run, RotatingMachine, Rating]:
    """Simulate a scenario on a shipped machine."""
    rated = rating(machine_name)
    machine = rotating(example(machine_name), "a scenario")
    assert machine.rated_current is not None
    n_p, I_n = machine.n_p, machine.rated_current
    # Rated voltage from the flux of the machine at rated current.
    psi = machine.flux_base(I_n)
    assert psi is not None
    U_n = rated.speed_e * psi
    other = chosen.other

    def offsets(knots: tuple[tuple[float, float, float], ...], base: float) -> Profile:
        return Profile([t for t, _, _ in knots], [(base * a, base * b) for _, a, b in knots])

    drive = encoder_drive(
        machine,
        rated,
        offset=offsets(chosen.current_offset, I_n),
        noise=chosen.noise * I_n,
        gain=other.get("gain", (1.0, 1.0, 1.0)),
        range=other["range"] * I_n if "range" in other else 1e9,
    )
    inverter = Inverter(
        dead_time=other.get("dead_time", 0.0) * rated.sample_time,
        drop=other.get("drop", 0.0) * rated.dc_link,
        smoothing=KNEE * I_n,
    )
    drive = replace(drive, inverter=inverter)
    dc_link = other.get("dc_link", ((0.0, 1.0),))
    course = Course(
        Profile([t for t, _ in chosen.speed], [x * rated.speed_e / n_p for _, x in chosen.speed]),
        Profile([t for t, _ in dc_link], [x * rated.dc_link for _, x in dc_link]),
        Profile([t for t, _ in chosen.load], [x * rated.torque for _, x in chosen.load]),
        offsets(chosen.voltage_offset, U_n),
        chosen.theta_e,
    )
    return simulate(drive, course, chosen.duration, seed), machine, rated
