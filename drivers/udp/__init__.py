"""UDP ports: the robot controller's and the camera's."""
