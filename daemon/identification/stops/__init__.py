"""What recorded stops and starts tell: ramps of the conveyor, and sway of the body."""
