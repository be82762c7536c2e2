"""Errors of joints: where they are, compared with their commands."""
