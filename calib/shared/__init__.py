"""What several capabilities need of the files of robots, and the core does not."""
