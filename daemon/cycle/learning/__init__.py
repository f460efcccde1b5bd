"""Learning from whole motions; a change is made while the robot stands."""
