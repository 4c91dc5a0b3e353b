"""What an observer will know, before the drive or the log exists: limits and test sequences."""
