"""The languages of controllers: their file suffixes and readers."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from pathlib import Path

from calib.core.base.errors import InputError
from calib.programs.languages import fanuc, krl, rapid, urscript
from calib.programs.languages.control_flow import Unknown
from calib.programs.languages.reader import Frames, Reader, read_frames
from calib.programs.languages.robot_program import Frame, RobotProgram

_READERS: dict[str, Callable[[Path | str, Frames, Collection[str]], Reader]] = {
    **dict.fromkeys(urscript.SUFFIXES, urscript.UrscriptReader),
    **dict.fromkeys(rapid.SUFFIXES, rapid.RapidReader),
    **dict.fromkeys(krl.SUFFIXES, krl.KrlReader),
    **dict.fromkeys(fanuc.SUFFIXES, fanuc.FanucReader),
}
_DECLARING: dict[str, Callable[[Path | str], Frames]] = {
    **dict.fromkeys(rapid.SUFFIXES, rapid.rapid_frames),
    ".dat": krl.krl_frames,
    ".csv": read_frames,
}
SUFFIXES = tuple(_READERS)


def read_program(path: Path | str, frames: Sequence[Path | str] = (), harmless: Sequence[str] = ()) -> RobotProgram:
    """Read a controller's program.

    Args:
        path: The file; its suffix decides the language.
        frames: Files with tools and frames that the program uses without declaring them: tables
            (`calib.programs.languages.reader.read_frames`), RAPID modules, KUKA's `$config.dat`.
        harmless: Routines declared elsewhere that change no target, tool, frame or mode.

    Raises:
        DataError: The message names file and line.
        InputError: No reader for files of this suffix.
    """
    known: dict[str, Frame | Unknown] = {}
    for file in frames:
        suffix = Path(file).suffix.lower()
        if suffix not in _DECLARING:
            raise InputError(
                f"--frames {file}: give a table (.csv), a RAPID module ({', '.join(rapid.SUFFIXES)}) or"
                " KUKA's $config.dat"
            )
        known |= _DECLARING[suffix](file)
    suffix = Path(path).suffix.lower()
    if suffix not in _READERS:
        raise InputError(f"{path}: is not a program of a controller; these end in {', '.join(SUFFIXES)}")
    names = harmless if suffix in urscript.SUFFIXES else [name.upper() for name in harmless]
    return _READERS[suffix](path, known, names).program()
