"""Quality of the rows of a log: marks from the signals alone, and rows without faulty samples."""
