"""From recorded stops and starts: ramps of the conveyor, and sway of the body."""
