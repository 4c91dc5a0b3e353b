"""Closed-form signals: the demo log, the firmware's test record, sensors."""
