"""Judging and choosing poses."""
