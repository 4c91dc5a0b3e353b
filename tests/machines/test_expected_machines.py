"""Compare computed properties of shipped and datasheet machines with committed values."""

import numpy as np
import pytest

from fluxobs.machines import RotatingMachine, example, example_names
from fluxobs.machines.new import new_machine
from support.expected import check

#: Currents in rotor coordinates, as shares of the rated current.
CURRENTS = np.array([0.1, 0.8j, -0.6 + 0.3j, 0.5 - 1.1j, 1.2 + 1.2j])
DATASHEETS = {
    "drone": ("surface-pmsm", {"poles": 14, "kv": 900, "R_line": 0.1, "L_line": 3e-5}),
    "servo": ("surface-pmsm", {"n_p": 4, "K_t": 0.5, "R_line": 1.2, "L_phase": 4e-3}),
    "interior": (
        "interior-pmsm",
        {"n_p": 3, "K_e": 0.4, "R_phase": 0.6, "L_line_min": 5e-3, "L_line_max": 9e-3},
    ),
    "rated": (
        "interior-pmsm",
        {"n_p": 3, "R_s": 0.6, "psi_f": 0.3, "rated_current": 20.0}
        | {"L_d": 6e-3, "L_q": 12e-3, "L_d_rated": 5e-3, "L_q_rated": 7e-3},
    ),
    "plate": (
        "induction",
        {"voltage": 400, "frequency": 50, "power": 2200, "current": 5, "speed": 1430}
        | {"cos_phi": 0.8},
    ),
    "t_model": (
        "induction",
        {"n_p": 2, "R_s": 3.7, "R_r": 2.5, "L_ls": 0.01, "L_lr": 0.012, "L_m": 0.24, "psi_R": 0.8},
    ),
}


def computed_properties(machine):
    properties = {
        "parameters": {
            name: value if isinstance(value, int | float | str | None) else str(type(value))
            for name, value in machine.parameters().items()
        },
        "R": machine.R,
        "B": machine.B,
        "page": machine._repr_html_(),
        "span": machine.position_span,
        "flux base": [machine.flux_base(2.0), machine.constraint_noise(0.3, 0.02)],
        "memory": machine.memory,
    }
    if not isinstance(machine, RotatingMachine):
        return properties
    rated = machine.rated_current or 5.0
    i = rated * CURRENTS
    psi = machine.flux_dq(i)
    flux, current = (np.stack([x.real, x.imag], axis=-1) for x in (psi * 1j, i * 1j))
    std = 0.01 * np.abs(psi)[:, None] * np.array([1.0, 0.5])
    relation = machine.constraint
    return properties | {
        "magnet": [machine.magnet_flux, machine.magnet_flux_std, machine.magnetizing_current],
        "inductances": [*machine.L_dq, machine.position_inductance, machine.transient_inductance],
        "inductance stds": machine.inductance_stds(0.1),
        "saliency": machine.saliency,
        "memories": [machine.memory_for(1e-4), machine.memory_for(5e-4, 300.0)],
        "flux": [psi.real, psi.imag],
        "position": machine.position(flux, current),
        "position std": machine.position_std(flux, std, current),
        "relation": [getattr(relation, name) for name in ("Q1", "Q2", "Q3", "d")],
        "inverter": str(machine.inverter),
    }


@pytest.mark.parametrize("name", example_names())
def test_a_shipped_machine(name):
    check(f"machines/{name}", computed_properties(example(name)))


@pytest.mark.parametrize("name", DATASHEETS)
def test_a_machine_from_a_datasheet(name):
    new = new_machine(*DATASHEETS[name])
    check(
        f"machines/new-{name}", {"text": new.text.splitlines(), **computed_properties(new.machine)}
    )
