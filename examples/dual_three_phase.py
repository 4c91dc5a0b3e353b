"""Define your own machine in ten lines: a dual three-phase PMSM, phase by phase.

Two three-phase windings, 30 degrees apart, share one magnet rotor. You define only the energies.
Currents, torque, dynamics and the relation for the flux observers follow from the energies.
"""

import jax.numpy as jnp
import numpy as np

from fluxobs.research import ElectromechanicalSystem, discover_constraint, inertia, linear_magnetics

axes = np.radians([0, 120, 240, 30, 150, 270])  # Magnetic axes of the six phases.
inductance = 0.2e-3 * np.eye(6) + 1e-3 * np.cos(axes[:, None] - axes)  # Leakage + air gap [H].
machine = ElectromechanicalSystem(
    linear_magnetics(lambda q: jnp.asarray(inductance), lambda q: 0.05 * jnp.cos(3 * q[0] - axes)),
    inertia(2e-3),
    R=[0.1] * 6,
    R_M=[1e-3],
    flux_range=(-0.1, 0.1),
    name="dual three-phase PMSM",
)

if __name__ == "__main__":
    result = discover_constraint(machine)
    print(f"{machine.name}: {len(result.relations)} quadratic relation between flux and current")
    print(f"  margin {result.margin:.0e}, residual at other states {result.residual:.0e}")
    print(f"{len(result.affine)} linear relations, in the planes without magnet flux:")
    for relation in result.affine:
        print(f"  {relation}")
