"""Simulated drives and closed-form signals: the truth against which observers are judged."""
