"""Planning of measurements: parameters that poses determine, the choice of poses, and the next pose while measuring."""
