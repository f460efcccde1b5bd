"""What recordings tell of servos, tool, swing, camera and sensors: numbers with their doubt."""
