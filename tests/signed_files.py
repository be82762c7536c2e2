"""Written files without the line in which the program says that it wrote them (tests/core/base/test_own_files.py)."""

import re
from pathlib import Path

_LINE = re.compile(rb"(?m)^(?:# |<!-- |; )written by medrue \S+ \(sha256 of the rest begins [0-9a-f]{16}\)(?: -->)?\n")
_ENTRY = re.compile(rb',\n "written_by": "[^"]*"(?=\n\}\n$)')


def plain(content: bytes) -> bytes:
    """What was in a file before its line was added."""
    return _ENTRY.sub(b"", _LINE.sub(b"", content))


def read_plain(path: Path) -> bytes:
    """A file without its line."""
    return plain(path.read_bytes())
