"""Benchmarks: the cost of a step, the turn-around of a reply, the clock."""
