"""The commands that plan measurements."""
