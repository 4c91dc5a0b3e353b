"""Estimate every row of a recorded log from the rows before and behind it."""
