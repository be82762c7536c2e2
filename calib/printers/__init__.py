"""Delta printers whose carriages slide on towers, in the words of three firmwares."""
