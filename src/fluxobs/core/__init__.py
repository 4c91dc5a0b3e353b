"""Foundations for all rooms: input, output, names, processes and pictures."""
