"""Hand-eye calibration: photographs of a printed board, pixels of its points, and the poses of camera and board."""
