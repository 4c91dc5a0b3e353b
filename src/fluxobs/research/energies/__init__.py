"""Machines as energies: dynamics and forces by differentiation, relations, trajectories."""
