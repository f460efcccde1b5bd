"""The sensors' bytes: distance over CAN, camera poses over UDP, force-torque over serial."""
