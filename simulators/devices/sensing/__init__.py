"""Sensors as the daemon sees them: distance, camera, force and torque."""
