"""Machines as energies, whose derivatives give dynamics and forces; relations and trajectories."""
