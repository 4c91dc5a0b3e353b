"""Modules that tests share: records, trajectories, the command line, compiled folders."""
