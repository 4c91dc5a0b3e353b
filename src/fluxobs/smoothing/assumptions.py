"""What the estimate of a log assumes, each with a prior standard deviation and its reason.

The C code lists the same assumptions in smoothing/assumptions.h. Their posterior is the error
budget of a row.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from .. import _smoother
from ..errors import MachineError
from ..logs.scales import Scales
from ..machines import InductionMachine, RotatingMachine
from ..observers.adaptive import (
    ASYMMETRY_STD,
    PSI_SHARE,
    default_inverter_std,
    default_resistance_std,
)

#: Names in the order of the C code.
NAMES: tuple[str, ...] = tuple(_smoother.assumptions.split())


@dataclass(frozen=True)
class Item:
    """An item of the error budget: one or more assumptions with a common remedy.

    Attributes
    ----------
    name : str
        Title in a summary.
    assumptions : tuple of str
        Names in the C code.
    reason : str
        Where the default standard deviation comes from.
    remedy : str
        What to measure or to state so that the item becomes smaller.
    stated_by : tuple of str
        Fields of a machine file and names of priors that state its standard deviation.
    """

    name: str
    assumptions: tuple[str, ...]
    reason: str
    remedy: str
    stated_by: tuple[str, ...]


ITEMS = (
    Item(
        "resistance",
        ("resistance",),
        "R_s_std of the machine file; default half of R_s: copper alone changes by 40 % per 100 K",
        "measure R_s at operating temperature, and state R_s_std",
        ("R_s_std", "resistance"),
    ),
    Item(
        "inverter",
        ("inverter_hard", "inverter_soft", "inverter_curve"),
        "inverter_voltage_std of the machine file; default the larger of a quarter of the rated "
        "resistive drop and 2 % of the DC link",
        "measure the inverter's voltage over the current at standstill, and state "
        "inverter_voltage and inverter_voltage_std",
        ("inverter_voltage_std", "inverter"),
    ),
    Item(
        "lag",
        ("lag", "delay"),
        "0.15 samples of the voltages, 0.2 of the currents: sampling instants and filters of "
        "usual drives differ by up to half a sample",
        "find the sampling instants in the drive's timing diagram, and state the lag and its "
        "standard deviation (--lag, --prior lag=0.05)",
        ("lag",),
    ),
    Item(
        "current offsets",
        ("offset_alpha", "offset_beta"),
        "1.5 % of the rated current: usual sensors without calibration",
        "record the currents with the bridge off, and subtract their mean",
        ("offset",),
    ),
    Item(
        "current gains",
        ("current_gain_re", "current_gain_im", "duty_gain"),
        "1 %: usual tolerance between the phases of sensors, and over the duty cycle",
        "calibrate the gains of the current sensors against each other, and at several duty cycles",
        ("current_gain", "duty_gain"),
    ),
    Item(
        "voltage gains",
        ("voltage_gain_re", "voltage_gain_im"),
        "0.5 %: phases of one bridge have nearly the same dead time",
        "measure the phase voltages at a duty cycle of one half",
        ("voltage_gain", "asymmetry"),
    ),
    Item(
        "DC link",
        ("link_sag",),
        "1 % lower at the rated current: the log has no udc, or measures it before the cables",
        "log the measured DC-link voltage",
        ("link_sag",),
    ),
    Item(
        "iron loss",
        ("iron_loss",),
        "a current of 2 % of the rated current at the usual voltage: usual no-load loss",
        "measure the no-load loss at two speeds",
        ("iron_loss",),
    ),
    Item(
        "L_d",
        ("L_d", "saturation_d"),
        "L_d_std (L_s_std, L_sigma_std) of the machine file; default 10 %: data sheets and "
        "saturation",
        "measure the inductances under load, and state their standard deviations",
        ("L_d_std", "L_s_std", "L_sigma_std", "L_d"),
    ),
    Item(
        "L_q",
        ("L_q", "saturation_q"),
        "L_q_std of the machine file; default 10 %: data sheets and saturation",
        "measure L_q under load, and state L_q_std, or give a flux map",
        ("L_q_std", "L_q"),
    ),
    Item(
        "magnet flux",
        ("psi_f",),
        "psi_f_std of the machine file; default a quarter of the flux",
        "measure the back-EMF at no load, and state psi_f_std",
        ("psi_f_std", "psi_f"),
    ),
    Item(
        "harmonics",
        ("fifth", "seventh"),
        "1.5 % of the magnet flux each: usual back-EMF waveforms",
        "measure the back-EMF's waveform at no load",
        ("harmonics",),
    ),
    Item(
        "axis of the injection",
        ("tilt",),
        "0.3°: cross-saturation, eddy currents, and inverter loss that alternates with the ripple",
        "give a flux map, which contains cross-saturation",
        ("tilt",),
    ),
    Item(
        "rotor",
        ("R_R", "L_M"),
        "30 % of R_R, 25 % of L_M: temperature and saturation",
        "identify R_R and L_M at operating temperature",
        ("R_R_std", "R_R", "L_M"),
    ),
)


def stated_items(machine: RotatingMachine, given: Iterable[str]) -> list[str]:
    """Return the names of the items whose standard deviation somebody states."""
    names = list(given)
    return [
        item.name
        for item in ITEMS
        if any(name in names or getattr(machine, name, None) is not None for name in item.stated_by)
    ]


#: Standard deviations that a user can give besides those of the adaptive observer: name → the
#: assumptions to which they apply, and the unit.
GIVEN: dict[str, tuple[tuple[str, ...], str]] = {
    "offset": (("offset_alpha", "offset_beta"), "A"),
    "lag": (("lag", "delay"), "samples"),
    "current_gain": (("current_gain_re", "current_gain_im"), "1"),
    "duty_gain": (("duty_gain",), "1"),
    "voltage_gain": (("voltage_gain_re", "voltage_gain_im"), "1"),
    "link_sag": (("link_sag",), "share at the rated current"),
    "iron_loss": (("iron_loss",), "share of the rated current"),
    "L_d": (("L_d",), "share"),
    "L_s": (("L_d",), "share"),
    "L_sigma": (("L_d",), "share"),
    "L_q": (("L_q",), "share"),
    "saturation": (("saturation_d", "saturation_q"), "1"),
    "harmonics": (("fifth", "seventh"), "share"),
    "tilt": (("tilt",), "rad"),
    "R_R": (("R_R",), "share"),
    "L_M": (("L_M",), "share"),
    "load": ((), "N m"),
    "voltage_scale": ((), "1"),
    "current_scale": ((), "1"),
}

#: Standard deviations of the lag of the voltages and of the delay of the currents [samples].
LAG_STD, DELAY_STD = 0.15, 0.2
#: Standard deviation of the offset of a current component, as a share of the rated current.
OFFSET_SHARE = 0.015
CURRENT_GAIN_STD = ASYMMETRY_STD
#: Change of a sensor's gain over the usual voltage of its phase: amplifiers and sampling instants
#: that depend on the duty cycle.
DUTY_GAIN_STD = 0.01
VOLTAGE_GAIN_STD = 0.005
IRON_LOSS_SHARE = 0.02
LINK_SAG_STD = 0.01
INDUCTANCE_SHARE = 0.1
HARMONIC_STD = 0.015
#: Tilt of the axis that an injected current shows [rad], as in the adaptive observer.
TILT_STD = np.pi / 600
ROTOR_RESISTANCE_SHARE, MAGNETIZING_SHARE = 0.3, 0.25
#: Standard deviation of the bend of the inverter's loss over the current [1].
CURVE_STD = 1.0
#: The same of a magnet flux that was guessed from the log, as a share.
GUESSED_PSI_SHARE = 0.5
#: Common scales of all voltages and of all currents [1]: they leave every angle unchanged.
VOLTAGE_SCALE_STD, CURRENT_SCALE_STD = 0.03, 0.01


def prior_stds(
    machine: RotatingMachine,
    scales: Scales,
    flux_base: float,
    given: Mapping[str, float] | None = None,
) -> dict[str, float]:
    """Return the prior standard deviation of each assumption; 0: exact, or not in this machine.

    Parameters
    ----------
    machine : RotatingMachine
    scales : Scales
        Sizes of the log's signals.
    flux_base : float
        Usual flux [Wb].
    given : mapping, optional
        Standard deviations that replace the defaults: resistance [Ω], inverter [V], asymmetry [1],
        psi_f [Wb], and those of GIVEN.
    """
    given = given or {}
    rated = machine.rated_current or scales.current
    inverter = default_inverter_std(machine, rated, 3**0.5 * scales.voltage)
    inverter = given.get("inverter", inverter)
    stds = dict.fromkeys(NAMES, 0.0)
    stds["resistance"] = given.get("resistance", default_resistance_std(machine))
    stds["inverter_hard"] = stds["inverter_soft"] = inverter
    stds["inverter_curve"] = CURVE_STD if inverter > 0 else 0.0
    stds["lag"], stds["delay"] = LAG_STD, DELAY_STD
    stds["offset_alpha"] = stds["offset_beta"] = OFFSET_SHARE * rated
    stds["current_gain_re"] = stds["current_gain_im"] = CURRENT_GAIN_STD
    stds["duty_gain"] = DUTY_GAIN_STD
    asymmetry = given.get("asymmetry", VOLTAGE_GAIN_STD)
    stds["voltage_gain_re"] = stds["voltage_gain_im"] = asymmetry
    stds["link_sag"] = LINK_SAG_STD
    stds["iron_loss"] = IRON_LOSS_SHARE * rated / scales.voltage
    inductances = machine.inductance_stds(INDUCTANCE_SHARE)
    L_d, L_q = (
        inductances[name] / L for name, L in zip(machine.inductances, machine.L_dq, strict=True)
    )
    stds["L_d"] = L_d
    stds["L_q"] = 0.0 if one_inductance(machine) else L_q
    stds["tilt"] = TILT_STD if shows_direction(machine) else 0.0
    if isinstance(machine, InductionMachine):
        share = ROTOR_RESISTANCE_SHARE if machine.R_R_std is None else machine.R_R_std / machine.R_R
        stds["R_R"], stds["L_M"] = share, MAGNETIZING_SHARE
    elif machine.magnets:
        share = PSI_SHARE if machine.magnet_flux else GUESSED_PSI_SHARE
        psi_f = machine.magnet_flux_std
        stds["psi_f"] = given.get("psi_f", share * flux_base if psi_f is None else psi_f)
        stds["fifth"] = stds["seventh"] = HARMONIC_STD
    for name, (assumptions, _) in GIVEN.items():
        if name in given:
            unit = rated / scales.voltage if name == "iron_loss" else 1.0
            for assumption in assumptions:
                if stds[assumption] > 0 or name == "saturation":
                    stds[assumption] = given[name] * unit
    return stds


@dataclass(frozen=True)
class Calibration:
    """Standard deviations of the scales common to all voltages and to all currents [1].

    They change no angle. A flux is proportional to the voltages, a resistance or an inductance to
    the ratio.
    """

    voltage: float
    current: float

    @classmethod
    def of(cls, given: Mapping[str, float]) -> Calibration:
        """Return the given or usual standard deviations."""
        return cls(
            given.get("voltage_scale", VOLTAGE_SCALE_STD),
            given.get("current_scale", CURRENT_SCALE_STD),
        )

    @property
    def ratio(self) -> float:
        """Standard deviation of the scale of a resistance, inductance or torque."""
        return float(np.hypot(self.voltage, self.current))


def with_scale(std: Any, value: Any, scale: float, prior: float = np.inf) -> Any:
    """Return a standard deviation that contains an unknown scale, at most the prior one."""
    variance = std**2 + (value * scale) ** 2
    return np.sqrt(variance / (1 + variance / prior**2)) if prior > 0 else 0.0 * variance


def check_given(machine: RotatingMachine, given: Iterable[str]) -> None:
    """Raise MachineError if a machine does not have a quantity of GIVEN."""
    single = one_inductance(machine)
    lacking = {
        "harmonics": ("no magnets", not machine.magnets),
        "R_R": ("no cage", not isinstance(machine, InductionMachine)),
        "L_M": ("no cage", not isinstance(machine, InductionMachine)),
        "L_q": ("only one inductance: give L_d", single),
        "saturation": ("no saliency, or a flux map", single or machine.saturation is not None),
        "tilt": ("no saliency", not shows_direction(machine)),
    }
    for name in given:
        reason, is_lacking = lacking.get(name, ("", False))
        if is_lacking:
            raise MachineError(f"prior {name}: this machine ({machine.kind}) has {reason}")


def shows_direction(machine: RotatingMachine) -> bool:
    """Whether an injected current shows the direction of the flux: the machine is salient."""
    if isinstance(machine, InductionMachine):
        return False
    return not one_inductance(machine) or machine.saturation is not None


def one_inductance(machine: RotatingMachine) -> bool:
    """Whether L_d stands for both inductances."""
    L_d, L_q = machine.L_dq
    return L_d == L_q
