"""Commands about the robot's controller."""
