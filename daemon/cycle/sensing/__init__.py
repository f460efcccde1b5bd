"""Sensor samples of a cycle: their queues, and the health of the sensors."""
