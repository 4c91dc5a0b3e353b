"""Where the electrical energy of a log went: copper, inverter, shaft, and what is left.

With the mean voltage u of an interval and the currents at its ends, the electrical energy is
3/2 ∫ u · i dt. The estimate says how much of it became heat in the winding and in the inverter, how
much is in the magnetic field, and how much left through the shaft. The rest tells whether torque,
resistance and voltages fit together, without a torque sensor. An iron loss is in the rest as far as
the log tells it; the other part counts as shaft, whose standard deviation contains it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..core.arrays import Array
from ..presentation import Result

#: Fewest intervals with an energy worth a balance.
LEAST_ROWS = 100


@dataclass(frozen=True)
class Energy:
    """Energies over the intervals between two valid rows [J].

    Attributes
    ----------
    electrical, copper, inverter, mechanical, stored : float
        Taken from the supply; heat of the winding and of the inverter; left through the shaft (of
        an induction machine: through the air gap, with the heat of the rotor); gained by the
        magnetic field.
    rest : float
        Electrical less all the others.
    std : float
        Standard deviation of the rest.
    through : str
        "shaft" or "air gap".
    """

    electrical: float
    copper: float
    inverter: float
    mechanical: float
    stored: float
    rest: float
    std: float
    through: str

    def text(self) -> str:
        """Return the balance as a sentence."""
        return (
            f"Energy over the valid rows: electrical {self.electrical:.4g} J = copper "
            f"{self.copper:.3g} + inverter {self.inverter:.3g} + {self.through} "
            f"{self.mechanical:.4g} + field {self.stored:.3g} + rest {self.rest:.3g} J "
            f"(± {self.std:.2g} J)"
        )


def energy_of(result: Result) -> Energy | None:
    """Return the energy balance of a log; None if too few rows are valid, or there is no torque."""
    machine, learnt = result.rotor, result.learnt
    if learnt is None or result.table is None or "torque" not in result:
        return None
    batches = list(result.log.aligned())
    u, i = (
        np.concatenate([getattr(batch, name) for batch in batches]) @ np.array([1, 1j])
        for name in ("voltage", "current")
    )
    flux = result["flux_alpha"] + 1j * result["flux_beta"]
    rotor = np.exp(1j * result["theta_e"])
    known = (result["valid"] > 0) & np.isfinite(i) & np.isfinite(result["torque"])
    pair = known[1:] & known[:-1] & np.isfinite(u[1:])
    if pair.sum() < LEAST_ROWS:
        return None
    h = result.log.sample_time

    def ends(values: Array) -> Array:
        """Return means over the intervals of a quantity at the rows."""
        return np.asarray((values[1:] + values[:-1])[pair] / 2)

    mean = (i[1:] + i[:-1])[pair] / 2
    electrical = 1.5 * h * float((u[1:][pair] * mean.conj()).real.sum())
    # ∫ |i|² of a current that is linear in time.
    a, b = i[:-1][pair], i[1:][pair]
    square = (np.abs(a) ** 2 + np.abs(b) ** 2 + (a * b.conj()).real) / 3
    copper = 1.5 * h * learnt.resistance * float(square.sum())
    axes = np.exp(-2j * np.pi / 3 * np.arange(3))
    flows = float(sum(np.abs((mean * axis).real).sum() for axis in axes)) * h
    inverter = learnt.inverter_voltage * flows
    angle = np.diff(np.unwrap(result["theta_e"]))[pair] / machine.n_p
    mechanical = float((ends(result["torque"]) * angle).sum())
    # Twice the field's energy of constant inductances is (λ - ψ_f) · i.
    field = 0.75 * (((flux - learnt.psi_f * machine.magnets * rotor) * i.conj()).real)
    stored = float(np.diff(field)[pair].sum())
    rest = electrical - copper - inverter - mechanical - stored
    stds = (
        float((ends(result["torque_std"]) * np.abs(angle)).sum()),
        copper * learnt.resistance_std / learnt.resistance,
        flows * learnt.inverter_std,
    )
    return Energy(
        *(electrical, copper, inverter, mechanical, stored, rest, float(np.linalg.norm(stds))),
        "air gap" if machine.flux_moves else "shaft",
    )
