"""The quantities that can vary from drive to drive: names, units and neutral values."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Quantity:
    """A quantity of a drive.

    Attributes
    ----------
    neutral : float
        Value if the specification does not name the quantity.
    unit, about : str
    least : float
        Exclusive lower limit.
    """

    neutral: float
    unit: str
    about: str
    least: float = float("-inf")


def _factor(about: str) -> Quantity:
    return Quantity(1.0, "", f"factor on {about}", 0.0)


def _share(about: str, least: float = float("-inf")) -> Quantity:
    return Quantity(0.0, "", about, least)


#: Quantities of every drive.
QUANTITIES = {
    "R": _factor("the stator resistance"),
    "L": _factor("all inductances, including a flux map"),
    "psi": _factor("the magnet flux; no effect on machines without magnets"),
    "temperature": Quantity(
        20.0,
        "°C",
        "temperature of copper, cage and magnets; the machine file applies at 20 °C",
        -200.0,
    ),
    "heat": _share("rise of the stator resistance over the record, share of its start", -1.0),
    "fifth": _share("5th harmonic of the magnet flux, share of the magnet flux"),
    "seventh": _share("7th harmonic of the magnet flux, share of the magnet flux"),
    "iron_loss": _share("current of the iron loss at rated speed, share of rated current", -1e-12),
    "inertia": _factor("the inertia"),
    "viscous": _share("viscous friction at rated speed, share of the rated torque", -1e-12),
    "coulomb": _share("dry friction, share of the rated torque", -1e-12),
    "speed": _factor("the speed of the course"),
    "load": Quantity(1.0, "", "factor on the load of the course"),
    "dc_link": _factor("the DC-link voltage"),
    "theta_e": Quantity(0.0, "rad", "electrical angle of the rotor at the start"),
    "dead_time": _share("dead time, share of the sample time", -1e-12),
    "drop": _share("voltage drop of a switch or diode, share of the DC link", -1e-12),
    "knee": Quantity(
        0.02, "", "width of the inverter's smoothed sign, share of the rated current", 0.0
    ),
    "offset_alpha": _share("current offset, share of the rated current"),
    "offset_beta": _share("current offset, share of the rated current"),
    "offset_change_alpha": _share("offset change over the record, share of the rated current"),
    "offset_change_beta": _share("offset change over the record, share of the rated current"),
    "voltage_offset_alpha": _share("voltage offset, share of the rated EMF"),
    "voltage_offset_beta": _share("voltage offset, share of the rated EMF"),
    "gain_a": _factor("the measured current of phase a"),
    "gain_b": _factor("the measured current of phase b"),
    "gain_c": _factor("the measured current of phase c"),
    "dc_link_gain": _factor("the measured DC-link voltage"),
    "noise": _share("current noise (std per component), share of the rated current", -1e-12),
    "quantum": _share("quantum of the A/D converter, share of the rated current", -1e-12),
    "range": Quantity(1e6, "", "limit of the current sensors, share of the rated current", 0.0),
    "jitter": _share("std of the sampling instant, share of the sample time", -1e-12),
    "lag": _share("delay of the current sensors, share of the sample time"),
    "lost": _share("share of the samples without a current; not in closed loop", -1e-12),
}

#: Names that set several quantities; each quantity is drawn independently.
TOGETHER = {
    "offset": ("offset_alpha", "offset_beta"),
    "offset_change": ("offset_change_alpha", "offset_change_beta"),
    "voltage_offset": ("voltage_offset_alpha", "voltage_offset_beta"),
    "gain": ("gain_a", "gain_b", "gain_c"),
}

#: Parameters of machine files; a specification varies them by factors under these names.
PARAMETERS = ("R_s", "L_s", "L_d", "L_q", "psi_f", "R_R", "L_sigma", "L_M")
