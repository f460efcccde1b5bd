"""Goal of the tool over the horizon: programmed and sensed poses, retraction, linear axis."""
