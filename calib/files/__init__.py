"""Files of measurements as other programs write them."""
