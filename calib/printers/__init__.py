"""Delta printers whose carriages slide on towers, in the words of three firmwares."""

COMMENTS = {"klipper": "#", "marlin": ";", "duet": ";"}
"""The firmwares, and how comments in their settings begin."""
