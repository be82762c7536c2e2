"""Measuring and calibrating at once: what is known so far, what to measure next, and when to stop."""
