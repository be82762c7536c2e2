"""Errors of joints: where they are beside their commands."""
