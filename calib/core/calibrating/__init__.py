"""Calibrating a robot: fit, judge, fit again; and the robots that files get."""
