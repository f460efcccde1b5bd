"""A run's cell from files: arm, task, configuration and scenario."""
