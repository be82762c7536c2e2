"""Name and version of the distribution that this package is part of."""

from importlib.metadata import version

DISTRIBUTION = "medrue"
VERSION = version(DISTRIBUTION)
PROGRAM = f"{DISTRIBUTION} {VERSION}"
"""How results and exported files name the program that wrote them."""
