"""Programs of the nominal robot for the calibrated one, and joint values that reach a goal."""
