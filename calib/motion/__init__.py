"""Robots that visit poses without collisions: shapes, surroundings, sight, paths between poses, programs."""
