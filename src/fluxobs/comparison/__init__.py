"""Comparison of observers: scenarios, the usual observers, their scores and the error bound."""
