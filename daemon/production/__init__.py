"""Car after car: queue of objects, the sequence of a cycle, and the quality record."""
