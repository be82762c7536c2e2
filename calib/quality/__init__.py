"""Proof for quality systems: that an installation computes rightly (`calib qualify`)."""
