"""Instruments: kinds of measurement, one file each, and the noise that they state."""
