"""The observers inside other people's simulators."""
