"""Meaning of the columns of a log: names, units, layouts, presets, guesses."""
