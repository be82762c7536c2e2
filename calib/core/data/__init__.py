"""Files of poses, measurements and parameters, and what they hold."""
