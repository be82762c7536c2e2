"""Machines that are their own instrument: kinds of measurement, joint terms, and origins under the names of trades."""
