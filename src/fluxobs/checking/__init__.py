"""Is a log what its user thinks? The usual mistakes, tried on stretches of it."""
