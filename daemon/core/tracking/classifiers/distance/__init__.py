"""What the distance sensor alone says: a step of its own, or a change of the conveyor."""
