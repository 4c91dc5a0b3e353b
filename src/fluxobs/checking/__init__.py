"""Check of a log: the usual mistakes, each tested on segments of the log."""
