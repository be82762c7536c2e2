"""Delta printers with carriages on towers, for three firmwares."""
