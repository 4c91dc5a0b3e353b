"""Observers side by side: scenarios, the observers that people use, scores and their bound."""
