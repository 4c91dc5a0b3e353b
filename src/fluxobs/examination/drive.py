"""Items on the drive: resistance and temperature, magnets, inverter, timing, encoder."""

from __future__ import annotations

import numpy as np

from ..estimation.learning import parameters
from ..logs.record import signed
from ..machines.heat import COLD, COPPER
from ..observers.adaptive import Learnt
from ..presentation import Result
from ..presentation.agreement import explains
from ..presentation.summary import mean_of
from .item import Item, flag_if, judge

#: Highest normal winding temperature, and largest standard deviation with which it says anything
#: [°C].
WARM, WARM_STD = 130.0, 20.0
#: Largest normal deviation of the magnet flux from the machine file (temperature, production).
MAGNET = 0.08
#: Largest normal inverter voltage, as a share of the log's voltage.
INVERTER = 0.03
#: Smaller errors of the lag [samples] do not matter: the effect of noise is larger.
LAG = 0.1
#: Largest normal inequality of the phase gains.
GAIN = 0.01
#: Largest normal drift, as a share of the voltage: it results from offsets of one percent.
DRIFT = 0.02
#: Largest normal eccentricity of an encoder and scatter of Hall edges [rad].
ECCENTRIC, HALL = np.radians(0.5), np.radians(5.0)


def learnt_items(result: Result, cold_resistance: float | None) -> list[Item]:
    """Return items on resistance, temperature, magnets, inverter, gains, and the sum of offsets."""
    if result.adaptive is None or result.learnt is None or not result.statistics.valid:
        words = "the position is never valid; correct the findings above first"
        return [Item("resistance, magnets, inverter", "cannot be told", words)]
    learnt = {parameter.name: parameter for parameter in parameters(result.adaptive, result.learnt)}
    items = []
    resistance = learnt.get("resistance")
    if resistance is not None:
        if resistance.told or resistance.std < 0.1 * resistance.value:  # the file's R_s is good
            items += _resistance_items(resistance.value, resistance.std, result, cold_resistance)
        else:
            items.append(
                _undetermined("resistance", "record steps of load, or slow rotation with current")
            )
    magnet = learnt.get("magnet flux")
    if magnet is not None and result.rotor.magnet_flux:
        items.append(_magnet_item(magnet.value, magnet.std, magnet.told, result))
    inverter = learnt.get("inverter")
    if inverter is not None:
        if inverter.told:
            items.append(_inverter_item(inverter.value, inverter.std, result))
        else:
            words = "record reversals of the current, or slow rotation with little current"
            items.append(_undetermined("inverter voltage", words))
    items.append(_gains_item(result, result.learnt))
    drift = mean_of(result, "drift")
    size, voltage = float(np.hypot(*drift)), result.scales.voltage
    verdict = flag_if(size > DRIFT * voltage)
    words = (
        f"{size / voltage:.1%} of the voltage; due to voltage offsets and current offsets times R_s"
    )
    items.append(Item("drift of the flux integral", verdict, words, size, None, "V"))
    return items


def _undetermined(name: str, test: str) -> Item:
    return Item(name, "cannot be told", f"to determine this value, {test}")


def _resistance_items(value: float, std: float, result: Result, cold: float | None) -> list[Item]:
    given = result.rotor.R_s
    items = [
        Item(
            "resistance of a phase",
            judge(value / given, std / given, 0.45, 1.2),
            f"{value / given:.0%} of the machine file's {given:.4g} Ω",
            value,
            std,
            "Ω",
        )
    ]
    reference = given if cold is None else cold
    temperature, temperature_std = (value / reference - 1) / COPPER + COLD, std / reference / COPPER
    words = "copper" if cold is not None else "copper, if the machine file's R_s is for 20 °C"
    verdict = (
        judge(temperature, temperature_std, WARM, 0.0)
        if temperature > COLD - 3 * temperature_std - 20
        else "look at it"
    )
    if verdict == "fine" and temperature_std > WARM_STD:
        verdict = "cannot be told"
    if verdict == "look at it" and temperature <= COLD:
        words += "; implausibly cold: R_s in the machine file is too large"
    items.append(Item("winding temperature", verdict, words, temperature, temperature_std, "°C"))
    return items


def _magnet_item(value: float, std: float, told: bool, result: Result) -> Item:
    given = result.rotor.magnet_flux or 0.0
    if not told and std > MAGNET * given:
        return _undetermined("magnet flux", "record some seconds of faster rotation")
    share, share_std = value / given, std / given
    words = f"{share:.1%} of the machine file's {given:.4g} Wb"
    verdict = judge(share, share_std, MAGNET, 1.0)
    if verdict == "look at it":
        words += (
            "; if the file is right, the magnets are hot (0.1 to 0.2 % per kelvin) or demagnetised"
            if share < 1
            else "; if the log's scales are right, psi_f in the machine file is too small"
        )
    return Item("magnet flux", verdict, words, value, std, "Wb")


def _inverter_item(value: float, std: float, result: Result) -> Item:
    log, voltage = result.log, result.scales.voltage
    words = (
        f"{value / voltage:.1%} of the voltage in this log; dead time and device drops of a phase"
    )
    link = log.layout.udc
    if link is None and "udc" in log.names:
        batch = next(log.channels(log.first, min(log.last, log.first + 1000)))
        link = float(np.nanmedian(batch["udc"]))
    if link:
        words += (
            f"; equals a dead time of {1e6 * value * log.sample_time / link:.2g} µs if the PWM "
            f"frequency is the sample rate"
        )
    verdict = judge(value, std, INVERTER * voltage)
    if verdict == "cannot be told":
        verdict = "fine"
    return Item("inverter voltage", verdict, words, value, std, "V")


def _gains_item(result: Result, learnt: Learnt) -> Item:
    assert result.adaptive is not None
    name, std = "unequal gains of the phases", max(learnt.asymmetry_std)
    prior = result.adaptive.asymmetry_std
    if not prior or std > 0.5 * prior:
        return _undetermined(name, "record some seconds of rotation under load")
    size = float(np.hypot(*learnt.asymmetry))
    verdict = judge(size, std, GAIN)
    return Item(
        name, verdict, "of the current sensors, or of the windings", 100 * size, 100 * std, "%"
    )


def lag_item(result: Result) -> Item:
    """Return the item on the voltage lag, from the estimate of the whole log."""
    name, lag, decision = "lag of the voltage", result.fractional_lag, result.lag
    words = "to determine this value, record changes of speed under load, or state --lag"
    if lag is None or not explains(result):
        return Item(name, "cannot be told", words)
    value, std = lag
    if decision is not None:
        if not decision.decided:
            return Item(name, "cannot be told", f"{decision.alternatives} fit; {words}")
        return Item(
            name, "fine", f"learnt from the log: {signed(decision.lag)}", value, std, "samples"
        )
    given = result.log.layout.lag
    verdict = judge(value, std, LAG, given)
    words = f"stated: {signed(given)}"
    if verdict == "look at it":
        words += f"; try --lag {round(value):g}"
    elif verdict == "cannot be told":  # the log allows other lags too
        verdict, words = "fine", f"{words}, which fits"
    return Item(name, verdict, words, value, std, "samples")


def truth_items(result: Result) -> list[Item]:
    """Return items that compare encoder, Hall sensors or speed with the estimate."""
    fit, true = result.truth_fit, result.log.true
    if true is None:
        words = "this log has no known encoder, Hall or speed signal; name one with --truth"
        return [Item("encoder", "cannot be told", words)]
    if fit is None:
        return [
            Item(f"truth {true.channel}", "cannot be told", "the position is hardly ever valid")
        ]
    name = {"hall": "Hall sensors"}.get(fit.channel, fit.channel)
    if not fit.parameters:
        return [Item(name, "look at it", "; ".join(fit.words))]
    if fit.channel == "hall":
        is_faulty = fit.wrong_turns or len(fit.words) > 2 or not fit.rms < HALL
        verdict = flag_if(is_faulty)
        return [Item(name, verdict, "; ".join(fit.words), np.degrees(fit.rms), None, "° scatter")]
    items = []
    if fit.wrong_turns:
        items.append(Item(name, "look at it", "; ".join(fit.words[:2])))
    for parameter in fit.parameters:
        if parameter.name == "gain":
            verdict = judge(parameter.value, parameter.std, 0.01, 1.0)
            items.append(
                Item("estimated over given speed", verdict, "", parameter.value, parameter.std, "")
            )
        elif parameter.name == "delay":
            words = "a positive delay means that the encoder is late"
            scale = 1e6
            limit = 0.5 * result.log.sample_time
            verdict = (
                judge(parameter.value, parameter.std, limit)
                if fit.lost is None
                else "cannot be told"
            )
            items.append(
                Item(
                    "encoder delay",
                    verdict,
                    words,
                    scale * parameter.value,
                    scale * parameter.std,
                    "µs",
                )
            )
        else:
            degrees = np.degrees([parameter.value, parameter.std])
            is_zero = parameter.name == "zero"
            verdict = "fine" if is_zero else judge(parameter.value, parameter.std, ECCENTRIC)
            verdict = verdict if is_zero or fit.lost is None else "cannot be told"
            words = "electrical; add this angle to the channel" if is_zero else "of the shaft"
            label = {
                "zero": "encoder zero",
                "eccentricity 1": "eccentricity, once a turn",
                "eccentricity 2": "eccentricity, twice a turn",
            }[parameter.name]
            items.append(Item(label, verdict, words, float(degrees[0]), float(degrees[1]), "°"))
    remaining = "remaining error of the truth"
    if fit.channel.startswith("speed"):
        value, unit = fit.rms, "rad/s, rms"
    else:
        value, unit = float(np.degrees(fit.rms)), "°, rms"
    items.append(Item(remaining, flag_if(fit.lost is not None), fit.lost or "", value, None, unit))
    return items
