"""Sensors' codecs: distance over CAN, camera poses over UDP, force-torque over serial."""
