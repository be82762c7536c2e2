"""Readings compared with what the robot predicts: whitened rows, their Jacobian, and what follows without a fit."""
