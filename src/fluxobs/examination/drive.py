"""What the drive's parameters say: resistance and heat, magnets, inverter, timing, encoder."""

from __future__ import annotations

import numpy as np

from ..errors import FluxobsError
from ..estimation import Result, estimate
from ..estimation.learning import parameters
from ..estimation.summary import mean_of
from ..identification import identify
from ..logs.log import Log
from ..machines import RotatingMachine
from ..machines.heat import COLD, COPPER
from ..observers.adaptive import Learnt
from ..observers.unknowns import ALL
from .item import Item, judged, look_if

#: A winding may be so warm [°C]; hotter is worth a look.
WARM = 130.0
#: A magnet's flux may differ from its plate by this share: heat, and spread of production.
MAGNET = 0.08
#: An inverter's voltage is usual up to this share of the rated resistive drop's … of the voltage.
INVERTER = 0.03
#: A lag that is off by less [samples] costs less than noise does.
LAG = 0.1
#: Unequal gains of the phases up to this share are usual.
GAIN = 0.01
#: A drift of this share of the voltage is usual: offsets of one percent.
DRIFT = 0.02
#: Encoder faults worth a look: eccentricity of the shaft, scatter of Hall edges [rad].
ECCENTRIC, HALL = np.radians(0.5), np.radians(5.0)


def run(log: Log, machine: RotatingMachine) -> Result:
    """The adaptive observer over a log, with all unknowns."""
    return estimate(log, machine, unknowns=ALL)


def learnt_items(result: Result, cold_resistance: float | None) -> list[Item]:
    """Resistance and temperature, magnets, inverter, gains, offsets together."""
    if result.adaptive is None or result.learnt is None or not result.statistics.valid:
        words = "the position is never valid; mend what is said above first"
        return [Item("resistance, magnets, inverter", "cannot be told", words)]
    found = {one.name: one for one in parameters(result.adaptive, result.learnt)}
    out = []
    resistance = found.get("resistance")
    if resistance is not None:
        if resistance.told or resistance.std < 0.1 * resistance.value:  # the file knows it
            out += _resistance(resistance.value, resistance.std, result, cold_resistance)
        else:
            out.append(_untold("resistance", "log steps of load, or slow rotation with current"))
    magnet = found.get("magnet flux")
    if magnet is not None and result.rotor.magnet_flux:
        out.append(_magnets(magnet.value, magnet.std, magnet.told, result))
    inverter = found.get("inverter")
    if inverter is not None:
        if inverter.told:
            out.append(_inverter(inverter.value, inverter.std, result))
        else:
            words = "log reversals of the current, or slow rotation with little current"
            out.append(_untold("inverter voltage", words))
    out.append(_gains(result, result.learnt))
    drift = mean_of(result, "drift")
    size, of = float(np.hypot(*drift)), result.scales.voltage
    verdict = look_if(size > DRIFT * of)
    words = f"{size / of:.1%} of the voltage; offsets of voltages and R_s times those of currents"
    out.append(Item("drift of the flux integral", verdict, words, size, None, "V"))
    return out


def _untold(name: str, test: str) -> Item:
    return Item(name, "cannot be told", f"to tell it, {test}")


def _resistance(value: float, std: float, result: Result, cold: float | None) -> list[Item]:
    given = result.rotor.R_s
    out = [
        Item(
            "resistance of a phase",
            judged(value / given, std / given, 0.45, 1.2),
            f"{value / given:.0%} of the machine file's {given:.4g} Ω",
            value,
            std,
            "Ω",
        )
    ]
    reference = given if cold is None else cold
    heat, spread = (value / reference - 1) / COPPER + COLD, std / reference / COPPER
    words = "copper" if cold is not None else "copper, if the machine file's R_s is that at 20 °C"
    verdict = judged(heat, spread, WARM, 0.0) if heat > COLD - 3 * spread - 20 else "look at it"
    if verdict == "look at it" and heat <= COLD:
        words += "; colder than any room: R_s in the machine file is too large"
    out.append(Item("winding temperature", verdict, words, heat, spread, "°C"))
    return out


def _magnets(value: float, std: float, told: bool, result: Result) -> Item:
    given = result.rotor.magnet_flux or 0.0
    if not told and std > MAGNET * given:
        return _untold("magnet flux", "log some seconds of faster rotation")
    share, spread = value / given, std / given
    words = f"{share:.1%} of the machine file's {given:.4g} Wb"
    verdict = judged(share, spread, MAGNET, 1.0)
    if verdict == "look at it":
        words += (
            "; weaker by heat (0.1 to 0.2 % a kelvin) or demagnetised, if the plate is right"
            if share < 1
            else "; is psi_f in the machine file of a line, or rms?"
        )
    return Item("magnet flux", verdict, words, value, std, "Wb")


def _inverter(value: float, std: float, result: Result) -> Item:
    log, of = result.log, result.scales.voltage
    words = f"{value / of:.1%} of the voltage in this log; dead time and device drops of a phase"
    link = log.layout.udc
    if link is None and "udc" in log.names:
        part = next(log.channels(log.first, min(log.last, log.first + 1000)))
        link = float(np.nanmedian(part["udc"]))
    if link:
        words += (
            f"; as much as a dead time of {1e6 * value * log.sample_time / link:.2g} µs, if the "
            f"PWM has the log's rate"
        )
    verdict = judged(value, std, INVERTER * of)
    if verdict == "cannot be told":
        verdict = "fine"
    return Item("inverter voltage", verdict, words, value, std, "V")


def _gains(result: Result, learnt: Learnt) -> Item:
    assert result.adaptive is not None
    name, std = "unequal gains of the phases", max(learnt.asymmetry_std)
    prior = result.adaptive.asymmetry_std
    if not prior or std > 0.5 * prior:
        return _untold(name, "log some seconds of rotation under load")
    size = float(np.hypot(*learnt.asymmetry))
    verdict = judged(size, std, GAIN)
    return Item(
        name, verdict, "of the current sensors, or of the windings", 100 * size, 100 * std, "%"
    )


def lag_item(log: Log, machine: RotatingMachine, as_given: bool) -> Item:
    """The lag of the voltage, fitted with resistance, magnets and inverter; `as_given`: whether
    the relation holds best with the lag that was given."""
    free = ["R_s", "inverter", "lag"]
    if machine.magnets:
        free.insert(1, machine.flux_name)
    given = log.layout.lag
    try:
        found = identify(log, machine, free=",".join(free))
    except FluxobsError as error:
        return Item("lag of the voltage", "cannot be told", str(error))
    lag = next((one for one in found.parameters if one.name == "lag"), None)
    if lag is None or lag.std is None or not found.after.converged:
        words = "changes of speed would tell it, or a true angle (--truth)"
        return Item("lag of the voltage", "cannot be told", words)
    verdict = judged(lag.value, lag.std, LAG, given)
    words = f"read with --lag {given:g}"
    if verdict == "look at it" and as_given:
        words = (
            f"a fit gives {lag.value:.2f}, but among whole lags the relation holds best with "
            f"{given:g}: the log is too short, or too even, to tell"
        )
        return Item("lag of the voltage", "cannot be told", words)
    if verdict == "look at it":
        words += f"; try --lag {lag.value:.2f}"
    return Item("lag of the voltage", verdict, words, lag.value, lag.std, "samples")


def truth_items(result: Result) -> list[Item]:
    """Encoder, Hall sensors or speed against the estimate."""
    fit, true = result.truth_fit, result.log.true
    if true is None:
        words = "no encoder, speed or Hall signal in this log; --truth names one"
        return [Item("encoder", "cannot be told", words)]
    if fit is None:
        return [
            Item(f"truth {true.channel}", "cannot be told", "the position is hardly ever valid")
        ]
    name = {"hall": "Hall sensors"}.get(fit.channel, fit.channel)
    if not fit.parameters:
        return [Item(name, "look at it", "; ".join(fit.words))]
    if fit.channel == "hall":
        bad = fit.wrong_turns or len(fit.words) > 2 or not fit.rms < HALL
        verdict = look_if(bad)
        return [Item(name, verdict, "; ".join(fit.words), np.degrees(fit.rms), None, "° scatter")]
    out = []
    if fit.wrong_turns:
        out.append(Item(name, "look at it", "; ".join(fit.words[:2])))
    for one in fit.parameters:
        if one.name == "gain":
            verdict = judged(one.value, one.std, 0.01, 1.0)
            out.append(Item("estimated over given speed", verdict, "", one.value, one.std, ""))
        elif one.name == "delay":
            words = "positive: the encoder comes late"
            scale = 1e6
            limit = 0.5 * result.log.sample_time
            verdict = judged(one.value, one.std, limit) if fit.lost is None else "cannot be told"
            out.append(
                Item("encoder delay", verdict, words, scale * one.value, scale * one.std, "µs")
            )
        else:
            degrees = np.degrees([one.value, one.std])
            zero = one.name == "zero"
            verdict = "fine" if zero else judged(one.value, one.std, ECCENTRIC)
            verdict = verdict if zero or fit.lost is None else "cannot be told"
            words = "electrical, to be added to the channel" if zero else "of the shaft"
            label = {
                "zero": "encoder zero",
                "eccentricity 1": "eccentricity, once a turn",
                "eccentricity 2": "eccentricity, twice a turn",
            }[one.name]
            out.append(Item(label, verdict, words, float(degrees[0]), float(degrees[1]), "°"))
    left = "what is left against it"
    if fit.channel.startswith("speed"):
        value, unit = fit.rms, "rad/s, rms"
    else:
        value, unit = float(np.degrees(fit.rms)), "°, rms"
    out.append(Item(left, look_if(fit.lost is not None), fit.lost or "", value, None, unit))
    return out
