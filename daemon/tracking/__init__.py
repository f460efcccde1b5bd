"""Where must the tcp be? Measurements in, a horizon of desired poses out (paper, Sect. III)."""
