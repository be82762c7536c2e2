"""Sources of robots other than URDFs: the plug-ins of capabilities and other packages for `calib init`.

An entry of the group `calib.first_descriptions` is a `FirstFiles`, named like its option.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from calib.core.commands.common import Output


@dataclass(frozen=True)
class FirstFiles:
    """The option for files of one kind, and its effect.

    Attributes:
        help: Help on the option.
        target: Message where a target is named, such as `a printer has its nozzle`.
        write: Function that writes description, URDF and measurements: the file, the texts of `--length`, the
            description to write.
        lengths: Text on `--length` for such files; empty: they take none.
    """

    help: str
    target: str
    write: Callable[[str, Sequence[str], Path, Output], None]
    lengths: str = ""
