"""Configuration: YAML documents, settings, the task file, parameters and overlays."""
