"""Files of measurements and of robots as other programs write them."""
