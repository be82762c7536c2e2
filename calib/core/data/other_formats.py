"""Other formats of measurements: known by their head, and converted to a table, or a message says what to do.

Capabilities and other packages add formats in the group `calib.readers`: each entry is a tuple of `OtherFormat`,
and the first that fits counts. What a file was taken for is logged as a warning (logger `calib`).
"""

from __future__ import annotations

import codecs
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from calib.core.base.errors import DataError
from calib.core.base.files import read_bytes
from calib.core.base.registry import load_group
from calib.core.base.words import warn_once

_BAGS = (".mcap", ".db3")
_HEAD = 1 << 16  # bytes by which a format is recognised
_ASCII = 0.7  # least part of ASCII characters in the head of a text file
_MARKS = ((codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"))


@dataclass(frozen=True)
class SomeFile:
    """A file whose head is read first.

    Attributes:
        path: The file.
        head: Its first bytes.
        renamed: Names of its columns, and the names in a table of this program, from the robot's description.
    """

    path: Path
    head: bytes
    renamed: Mapping[str, str]

    @cached_property
    def encoding(self) -> str:
        """Encoding of the text: by its byte order mark, else UTF-8 if the head is valid, else Windows' Latin-1."""
        marked = next((name for mark, name in _MARKS if self.head.startswith(mark)), None)
        if marked is not None:
            return marked
        try:
            codecs.getincrementaldecoder("utf-8")().decode(self.head)
        except UnicodeDecodeError:
            return "cp1252"
        return "utf-8"

    @cached_property
    def first_lines(self) -> list[str]:
        """Lines of the file's head; none if the file is no text."""
        binary = b"\0" in self.head or len(self.head.decode("ascii", "ignore")) < _ASCII * len(self.head)
        if binary and self.encoding != "utf-16":
            return []
        return codecs.getincrementaldecoder(self.encoding)(errors="replace").decode(self.head).splitlines()

    @cached_property
    def lines(self) -> list[str]:
        """All lines of the file."""
        content = read_bytes(self.path, "a table", DataError)
        return content.decode(self.encoding, errors="replace").splitlines()


@dataclass(frozen=True)
class OtherFormat:
    """A format of files.

    Attributes:
        name: Name of the format, as messages have it.
        head: Marks by which it is known, in words.
        taken: How it is read, in words; or if it is not, what to do.
        fits: Whether a file is one.
        read: Returns lines of a table of this program, or its columns by header; None if it cannot be read.
    """

    name: str
    head: str
    taken: str
    fits: Callable[[SomeFile], bool]
    read: Callable[[SomeFile], list[str] | dict[str, Sequence[object]]] | None = None


def other_formats() -> list[OtherFormat]:
    """Return the formats, in the order in which they are tried."""
    return [each for _, given in load_group("calib.readers", "reader of files") for each in given]


def is_bag(path: Path | str) -> bool:
    """Return whether a path is a ROS 2 bag: a folder with `metadata.yaml`, or a file `.mcap` or `.db3`.

    The entry point `bags` of the group `calib.methods` is the module that reads them.
    """
    try:
        return Path(path).suffix in _BAGS or (Path(path) / "metadata.yaml").is_file()
    except OSError:  # reading the file will raise the error
        return False


def read_other(path: Path | str, renamed: Mapping[str, str]) -> list[str] | dict[str, Sequence[object]] | None:
    """Return the content of a file of another format, as lines of a table or columns by header; None for no format.

    A format that cannot be read is a `DataError`, which says what it is and what to do.
    """
    try:
        if not Path(path).is_file():
            return None
        with Path(path).open("rb") as stream:
            file = SomeFile(Path(path), stream.read(_HEAD), renamed)
    except OSError:  # reading the file as a table will raise the error
        return None
    known = next((each for each in other_formats() if each.fits(file)), None)
    if known is None:
        return None
    if known.read is None:
        raise DataError(f"{path}: this looks like {known.name}: {known.taken}")
    warn_once(f"{path}: read as {known.name}: {known.taken}")
    return known.read(file)
