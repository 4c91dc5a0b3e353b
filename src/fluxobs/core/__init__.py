"""Foundations for all packages: input, output, names, processes and pictures."""
