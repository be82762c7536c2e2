"""The commands about photographs of a printed board."""
