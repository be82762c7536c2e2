"""Files of poses, measurements and parameters, and their content."""
