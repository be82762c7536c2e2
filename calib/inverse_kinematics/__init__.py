"""Joint values that bring a target to a goal, through closed loops."""
