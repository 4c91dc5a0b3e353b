"""The drive of a scenario: the true machine, its inverter and sensors, and its course."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..errors import UsageError
from ..machines import RotatingMachine, as_machine, rotating
from ..machines.heat import CAGE, COLD, COPPER, NEODYMIUM
from ..simulation.drive import (
    RATINGS,
    Course,
    Drive,
    Inverter,
    Mechanics,
    Motor,
    Plant,
    Profile,
    Rating,
    Sensors,
    encoder_drive,
)
from ..simulation.drive.motor import MappedMotor
from .courses import course_of
from .draws import Scenario
from .quantities import PARAMETERS, QUANTITIES
from .specification import Specification


@dataclass(frozen=True, eq=False)
class Cell:
    """The nominal drive of one machine, which observers and controller assume."""

    name: str
    machine: RotatingMachine
    rated: Rating
    nominal: Drive

    @property
    def current(self) -> float:
        """Rated current [A peak]."""
        assert self.machine.rated_current is not None
        return self.machine.rated_current

    @property
    def flux(self) -> float:
        """Flux at the rated current [Wb]."""
        flux = self.machine.flux_base(self.current)
        assert flux is not None  # known for every simulated machine
        return flux

    @property
    def voltage(self) -> float:
        """Rated EMF [V]."""
        return self.rated.speed_e * self.flux


@lru_cache(maxsize=8)
def _cell(name: str, drive_table: tuple[tuple[str, float], ...]) -> Cell:
    machine = rotating(as_machine(name), "a campaign")
    if machine.rated_current is None:
        raise UsageError(f"{name}: rated_current is missing; a campaign needs it")
    values = dict(drive_table)
    if name in RATINGS:
        values = vars(RATINGS[name]) | values
    missing = [field for field in Rating.__dataclass_fields__ if field not in values]
    if missing:
        raise UsageError(
            f"{name} is not a shipped machine: give its {', '.join(missing)} in [drive]"
        )
    rated = Rating(**values)
    return Cell(name, machine, rated, encoder_drive(machine, rated))


def cell_of(specification: Specification, name: str) -> Cell:
    """Return the nominal drive of a machine (cached).

    Raises
    ------
    FluxobsError
        The machine lacks a value, or [drive] lacks a rating.
    """
    drive_table = specification.drive.model_dump(exclude_none=True)
    return _cell(name, tuple(sorted(drive_table.items())))


def planned_cell(name: str, rated: Rating) -> Cell:
    """Return the nominal drive of a machine with these ratings (cached)."""
    return _cell(name, tuple(sorted(vars(rated).items())))


def motor_of(machine: RotatingMachine, values: dict[str, float]) -> Motor:
    """Return the motor of a scenario: the machine with its tolerances at its temperature."""
    temperature_rise = values.get("temperature", COLD) - COLD
    common = {"L": values.get("L", 1.0), "R": values.get("R", 1.0), "psi": values.get("psi", 1.0)}
    factors = {name: values.get(name, 1.0) for name in PARAMETERS}
    factors["R_s"] *= common["R"] * (1 + COPPER * temperature_rise)
    factors["R_R"] *= 1 + CAGE * temperature_rise
    factors["psi_f"] *= common["psi"] * (1 + NEODYMIUM * temperature_rise)
    for name in ("L_s", "L_d", "L_q", "L_sigma", "L_M"):
        factors[name] *= common["L"]
    if not min(factors.values()) > 0:
        raise UsageError("a parameter is not positive after its tolerance")
    if machine.saturation is None:
        for name, factor in factors.items():
            if factor != 1.0:
                machine = machine.scaled((name,), factor)
        return Motor.of(machine)
    # A flux map keeps its shape: the magnet flux and the flux of the currents are scaled.
    motor = Motor.of(machine)
    assert isinstance(motor, MappedMotor)
    d, q = (factors[name] for name in machine.inductances)
    nominal_map = motor.map
    coefficients = np.array(nominal_map.coefficients)
    psi = float(nominal_map.psi)
    coefficients[..., 0] = d * (coefficients[..., 0] - psi) + factors["psi_f"] * psi
    coefficients[..., 1] *= q
    scaled = {
        "R_s": factors["R_s"] * motor.R_s,
        "L_d": d * motor.L_d,
        "L_q": q * motor.L_q,
        "psi_f": factors["psi_f"] * motor.psi_f,
    }
    scaled_map = replace(
        nominal_map,
        psi=jnp.asarray(factors["psi_f"] * psi),
        L_d=jnp.asarray(d * nominal_map.L_d),
        L_q=jnp.asarray(q * nominal_map.L_q),
        coefficients=jnp.asarray(coefficients),
    )
    names = (*scaled, "map")
    scaled_motor: Motor = eqx.tree_at(
        lambda m: [getattr(m, name) for name in names], motor, [*scaled.values(), scaled_map]
    )
    return scaled_motor


def drive_of(specification: Specification, scenario: Scenario) -> tuple[Drive, Course]:
    """Return drive and course of a scenario; the controller assumes the machine file.

    Raises
    ------
    FluxobsError
        A value is impossible.
    """
    cell = cell_of(specification, scenario.machine)
    table = specification.course
    value = {name: quantity.neutral for name, quantity in QUANTITIES.items()} | scenario.values
    for name, quantity in QUANTITIES.items():
        if not value[name] > quantity.least:
            raise UsageError(f"{name} = {value[name]:g} is impossible for a drive")
    rated, current, h = cell.rated, cell.current, cell.rated.sample_time
    rated_speed = rated.speed_e / cell.machine.n_p

    def vector(name: str, scale: float) -> np.ndarray:
        return scale * np.array([value[f"{name}_alpha"], value[f"{name}_beta"]])

    start, change = vector("offset", current), vector("offset_change", current)
    offset: Any = start
    if change.any():
        offset = Profile([0.0, table.duration], [start, start + change])
    mechanics = Mechanics(
        value["inertia"] * rated.J,
        viscous=max(value["viscous"], 0.0) * rated.torque / rated_speed,
        coulomb=max(value["coulomb"], 0.0) * rated.torque,
        smoothing=1e-3 * rated_speed,
    )
    iron_current = max(value["iron_loss"], 0.0) * current
    motor = eqx.tree_at(
        lambda m: [m.fifth, m.seventh, m.iron_loss],
        motor_of(cell.machine, scenario.values),
        [jnp.asarray(x) for x in (value["fifth"], value["seventh"], iron_current / cell.voltage)],
    )
    drive = replace(
        cell.nominal,
        plant=Plant(motor, mechanics),
        inverter=Inverter(
            dead_time=max(value["dead_time"], 0.0) * h,
            drop=max(value["drop"], 0.0) * rated.dc_link,
            smoothing=value["knee"] * current,
        ),
        sensors=Sensors(
            offset=offset,
            noise=max(value["noise"], 0.0) * current,
            gain=[value["gain_a"], value["gain_b"], value["gain_c"]],
            quantum=max(value["quantum"], 0.0) * current,
            range=value["range"] * current,
            jitter=max(value["jitter"], 0.0) * h,
            lag=value["lag"] * h,
            dc_link_gain=value["dc_link_gain"],
        ),
    )
    speed, load = course_of(table, scenario)
    course = Course(
        Profile([t for t, _ in speed], [value["speed"] * x * rated_speed for _, x in speed]),
        value["dc_link"] * rated.dc_link,
        Profile([t for t, _ in load], [value["load"] * x * rated.torque for _, x in load]),
        vector("voltage_offset", cell.voltage),
        value["theta_e"],
        heat=Profile([0.0, table.duration], [1.0, 1.0 + value["heat"]]),
    )
    return drive, course
