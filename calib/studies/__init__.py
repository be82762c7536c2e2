"""Many calibrations of one robot: what to expect of the next one."""
