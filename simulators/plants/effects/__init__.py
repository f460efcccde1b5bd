"""Effects of a real cell on conveyor and sensors, each with its own switch, off by default."""
