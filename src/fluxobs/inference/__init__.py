"""Inference from a whole log: one posterior of its parameters and rows, computed in C (engine/)."""
