"""Signals made from closed forms: the demo log, the firmware's test record, sensors."""
