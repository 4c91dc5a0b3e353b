"""Simulated drives and closed-form signals, whose truth shows the errors of observers."""
