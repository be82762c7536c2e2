"""A theodolite and a hysteresis of joints, for calib: an example of a package that adds to it."""
