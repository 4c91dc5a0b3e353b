"""Simulated drives and signals in closed form: the truth that observers are judged by."""
