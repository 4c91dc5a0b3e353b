"""Commands of the program, one per file."""
