"""How does the robot get there? A horizon of desired poses in, setpoints out (paper, Sect. IV)."""
