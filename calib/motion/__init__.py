"""From a plan to a robot that moves: shapes, surroundings, sight, ways between poses, programs."""
