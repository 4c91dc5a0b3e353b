"""Time of a log: stamps, gaps, jitter, clocks of several files, voltage intervals."""
