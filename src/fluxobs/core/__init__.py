"""What every room builds on: input, output, names, processes and pictures."""
