"""Many calibrations of one robot: the statistics to expect of the next calibration."""
