"""The commands of the `calib` program: parse, call, print."""
