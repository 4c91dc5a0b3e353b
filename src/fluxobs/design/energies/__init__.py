"""Machines as energies: dynamics and forces by differentiation, their relations, trajectories."""
