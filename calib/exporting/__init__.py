"""The robot in the formats that other programs read."""
