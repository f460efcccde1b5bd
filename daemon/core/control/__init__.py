"""Control: a horizon of desired poses in, setpoints within the limits out (paper, Sect. IV)."""
