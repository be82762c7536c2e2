"""Joint values that bring the calibrated robot to a goal, through closed loops, and how far off it will be."""
