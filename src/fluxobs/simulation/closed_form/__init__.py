"""Signals in closed form: the demo log, the firmware's test record, sensors."""
