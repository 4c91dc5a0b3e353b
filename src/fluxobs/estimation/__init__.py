"""Estimation over a log: one or two passes of the observer, statistics, and a truth to compare."""
