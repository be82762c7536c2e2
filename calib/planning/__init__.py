"""Poses to measure: what they determine, the choice of them, and the next one."""
