"""The process: configuration, loop, clock, states, recorder, doors."""
