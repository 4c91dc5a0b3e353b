"""Observers side by side: scenarios, the usual observers, their scores and the error bound."""
