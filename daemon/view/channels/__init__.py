"""Standard channels for viewers: Foxglove, PlotJuggler, Rerun."""
