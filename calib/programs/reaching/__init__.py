"""Joint values that bring the calibrated robot to a goal, through closed loops, and the error to expect there."""
