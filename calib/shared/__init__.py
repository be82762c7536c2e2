"""What several capabilities need, and the core does not: of poses, and of the files of robots."""
