"""The sampling clock: phase lock, schedule, timer and cycle timing."""
