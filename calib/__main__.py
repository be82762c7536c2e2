"""`python -m calib` is the `calib` program."""

from calib.cli import main

main()
