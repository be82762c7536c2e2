"""Files of poses, measurements and parameters, repeats, and simulated measurements."""
