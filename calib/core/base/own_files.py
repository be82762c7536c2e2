"""Files that may be replaced: those that this program wrote and that are unchanged since, but none that it has read.

A single file ends in a line that names the program and the beginning of the digest of all other lines: a comment of its
format, or the last entry of JSON. In a folder, one more file has the digest of each file (`MANIFEST`). So a file tells
by itself, on any machine, whether this program wrote it, and whether it was changed since: a plan into which
measurements were filled, a description that was edited.

Other files belong to others. Replacing them is an `InputError` unless it is forced; the same holds for a file that the
command has read, under any name. Empty files, and files that would not change, may always be replaced.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path

from calib.core.base.errors import InputError
from calib.core.base.version import PROGRAM

MANIFEST = ".written-by-calib.json"
"""File of a folder that says what this program wrote into it."""
_MARK = re.compile(rb"written by \S+ [^\s,]+(?: \(|, )sha256 of the rest begins ([0-9a-f]{16})\)")
_OLD_LINES = re.compile(rb"^[#; <!(-]*" + _MARK.pattern + rb"[ ->]*\n", re.MULTILINE)
_END_OF_JSON = b"\n}\n"
_LOOKS = 10  # times that a folder is read while another program replaces it
_inputs: ContextVar[set[tuple[int, int]] | None] = ContextVar("inputs", default=None)
"""Device and number of each file that the present command has read; None where no command runs."""


@contextmanager
def inputs_noted() -> Iterator[None]:
    """Note the files that a command reads within the block, so that the command does not replace them."""
    token = _inputs.set(set())
    try:
        yield
    finally:
        _inputs.reset(token)


def note_input(state: os.stat_result) -> None:
    """Say that the present command, if one runs, reads a file."""
    noted = _inputs.get()
    if noted is not None:
        noted.add((state.st_dev, state.st_ino))


def note_output(state: os.stat_result) -> None:
    """Say that the present command, if one runs, has written a file: its number may be that of a file that is gone."""
    noted = _inputs.get()
    if noted is not None:
        noted.discard((state.st_dev, state.st_ino))


def signed(content: bytes, comment: str = "") -> bytes:
    """Return a file with the line that says who wrote it: JSON, which has no comments, XML of any kind, or lines.

    A comment begins with `comment`; if that is not given, as in XML or in tables. One in parentheses has no others, and
    stands before the mark that ends a tape (`%`).
    """
    text = _OLD_LINES.sub(b"", content)
    if not text.endswith(b"\n"):
        text += b"\n"
    if text.startswith(b"{") and text.endswith(_END_OF_JSON):
        text, end = text.removesuffix(_END_OF_JSON) + b",\n", _END_OF_JSON[1:]
        return text + b' "written_by": "' + _mark(_digest(text + end)) + b'"\n' + end
    if text.lstrip().startswith(b"<") and not comment:
        return text + b"<!-- " + _mark(_digest(text)) + b" -->\n"
    if comment == "(":
        lines = text.splitlines(keepends=True)
        lines.insert(
            len(lines) - (lines[-1].strip() == b"%"), b"(" + _mark(_digest(text)).replace(b" (", b", ") + b"\n"
        )
        return b"".join(lines)
    return text + f"{comment or '#'} ".encode() + _mark(_digest(text)) + b"\n"


def is_mark(line: str) -> bool:
    """Whether a line of a file is the one that says who wrote it."""
    return _MARK.search(line.encode()) is not None


def _mark(digest: str) -> bytes:
    return f"written by {PROGRAM} (sha256 of the rest begins {digest[:16]})".encode()


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def is_own(path: Path) -> bool:
    """Whether a file is unchanged since this program wrote it, alone or with its folder."""
    if path.name == MANIFEST:
        return True
    manifest = read_manifest(path.parent)
    for _ in range(_LOOKS):
        content, before, manifest = path.read_bytes(), manifest, read_manifest(path.parent)
        if manifest.get(path.name) == _digest(content):
            return True
        if manifest == before:
            break
    for mark in _MARK.finditer(content):
        start = content.rfind(b"\n", 0, mark.start()) + 1
        end = content.find(b"\n", mark.end()) + 1
        if end and _digest(content[:start] + content[end:])[:16] == mark[1].decode():
            return True
    return False


def read_manifest(folder: Path) -> dict[str, str]:
    """Return the digest of each file that this program wrote into a folder; empty if the folder has no manifest."""
    with suppress(OSError, ValueError, RecursionError):
        content = json.loads((folder / MANIFEST).read_bytes())
        if isinstance(content, dict) and isinstance(content.get("sha256"), dict):
            return {str(name): str(digest) for name, digest in content["sha256"].items()}
    return {}


def manifest_of(folder: Path, files: Mapping[str, bytes], obsolete: Collection[str]) -> bytes:
    """Return the manifest of a folder with these new files, and with other files that this program wrote before."""
    others = {name: digest for name, digest in read_manifest(folder).items() if (folder / name).is_file()}
    digests = {name: digest for name, digest in others.items() if name not in obsolete}
    digests |= {name: _digest(content) for name, content in files.items()}
    content = {"written_by": PROGRAM, "sha256": dict(sorted(digests.items()))}
    return (json.dumps(content, indent=1, ensure_ascii=False) + "\n").encode()


def require_replaceable(
    path: Path, content: bytes | None = None, *, inputs: Iterable[Path | str] = (), force: bool = False
) -> None:
    """Raise `InputError` if a file, which may be missing, should not be replaced by `content` (if that is known).

    `inputs` are further files from which the output was made; `force` replaces it all the same.
    """
    if force or not path.is_file():
        return
    noted = {*(_inputs.get() or ()), *_file_numbers(inputs)}
    choose = "choose another place for the output (--force, in Python force=True, replaces it)"
    with suppress(FileNotFoundError):  # another program replaces the folder just now
        state = path.stat()
        if (state.st_dev, state.st_ino) in noted:
            raise InputError(f"{path}: is read by this command, which would replace it; {choose}")
        if state.st_size and not is_own(path) and (content is None or path.read_bytes() != content):
            raise InputError(f"{path}: was not written by this program, or was changed since; {choose}")


def _file_numbers(inputs: Iterable[Path | str]) -> Iterator[tuple[int, int]]:
    for path in inputs:
        with suppress(OSError, ValueError):
            state = Path(path).stat()
            yield state.st_dev, state.st_ino
