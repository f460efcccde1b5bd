"""The demonstration of car after car in real time."""
