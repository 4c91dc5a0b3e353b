"""Observers inside simulators of other projects."""
