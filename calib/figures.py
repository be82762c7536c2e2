"""Drawing is not this package's business: figures come from whatever is installed under an entry point group.

An entry of `calib.figures` has a name (`assessment`, `selection`) and is a callable that takes such an object and
returns file name -> content.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import entry_points

from calib.errors import InputError

FIGURES = "calib.figures"


def draw(kind: str, subject: object) -> dict[str, bytes]:
    """Return figures of an object as files, name -> content.

    Args:
        kind: `assessment` or `selection`.
        subject: What to draw.

    Raises:
        InputError: Nothing that draws is installed, or matplotlib is missing.
    """
    found = [entry for entry in entry_points(group=FIGURES) if entry.name == kind]
    if not found:
        raise InputError(f"--plots: nothing that draws an {kind} is installed (entry point group {FIGURES})")
    files: dict[str, bytes] = {}
    for entry in found:
        try:
            write: Callable[[object], dict[str, bytes]] = entry.load()
            files.update(write(subject))
        except ImportError as error:
            raise InputError(f"--plots: {error.name} is not installed; `pip install {error.name}` first") from None
    return files
