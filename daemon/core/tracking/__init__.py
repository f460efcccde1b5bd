"""Tracking: measurements in, a horizon of desired tcp poses out (paper, Sect. III)."""
