"""First files of a robot: descriptions with comments, measurements to fill in, mechanisms from a few lengths."""
