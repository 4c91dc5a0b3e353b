"""Time of a log: time stamps, gaps, jitter, clocks of several files, and voltage intervals."""
