"""Machines that are their own instrument: kinds of measurement, joint terms, and origins in the names of trades."""
