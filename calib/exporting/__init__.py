"""The robot in the formats of other programs."""
