"""Delta printers with carriages on towers, for three firmwares."""

COMMENTS = {"klipper": "#", "marlin": ";", "duet": ";"}
"""The firmwares, and the mark of comments in their settings."""
