"""Shared by tests: records, trajectories, the command line, compiled folders."""
