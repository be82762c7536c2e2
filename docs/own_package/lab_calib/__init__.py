"""A theodolite, a hysteresis and a lag of joints, for calib: an example of a package that adds to it."""
