"""Classifiers of what the conveyor does: running, stopping, starting."""
