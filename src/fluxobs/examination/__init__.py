"""Examination of a drive from an ordinary log, with the questions of a service engineer."""
