"""Files: read up to a size that memory holds; written elsewhere and then renamed, so that none is half written."""

from __future__ import annotations

import base64
import errno
import os
import tempfile
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from calib.core.base.errors import CalibrationError, InputError
from calib.core.base.own_files import MANIFEST, manifest_of, note_input, note_output, require_replaceable, signed
from calib.core.base.replacing import clear_leftovers, new_folder, replace_folder

_FILE_ENDINGS = (
    *(".csv", ".html", ".json", ".pdf", ".urdf", ".xml", ".yaml", ".yml"),
    *(".pkl", ".pickle", ".joblib", ".npz", ".npy", ".h5", ".mat", ".txt", ".zip"),
)
_STREAM_FOLDERS = (Path("/dev"), Path("/dev/fd"))
_LARGEST = 2**28  # bytes: a million rows and more, and less than memory
_PIECE = 2**20  # bytes at once
_LARGEST_IMAGE = 2**19  # bytes: it stands in every report
_IMAGES = ((b"\x89PNG\r\n\x1a\n", "png"), (b"\xff\xd8\xff", "jpeg"), (b"<svg", "svg+xml"), (b"<?xml", "svg+xml"))


def read_bytes(path: Path | str, expected: str, error: type[CalibrationError]) -> bytes:
    """Return what a file, or a pipe, holds; `expected` names it, such as `a CSV file`.

    An `error` of the given type if it is missing, unreadable, or larger than 256 MB.
    """
    pieces, size = list[bytes](), 0
    try:
        with Path(path).open("rb") as stream:
            note_input(os.fstat(stream.fileno()))
            while size <= _LARGEST and (piece := stream.read(_PIECE)):
                pieces.append(piece)
                size += len(piece)
    except FileNotFoundError:
        raise error(f"{path}: no such file; give {expected}") from None
    except OSError as problem:
        raise error(f"{path}: cannot be read ({(problem.strerror or str(problem)).lower()})") from None
    except ValueError as problem:  # a name with a zero byte, which YAML can spell
        raise error(f"{str(path)!r}: cannot be read ({problem})") from None
    if size > _LARGEST:
        raise error(f"{path}: is larger than {_LARGEST >> 20} MB; is this {expected}?")
    return b"".join(pieces)


def read_text(path: Path | str, expected: str, error: type[CalibrationError], *, growing: bool = False) -> str:
    """Return the text of a file without byte order mark and with one kind of line ends.

    `growing`: the file is still written, and a last line without its end is left out.
    """
    content = read_bytes(path, expected, error)
    if growing:
        content = content[: max(content.rfind(b"\n"), content.rfind(b"\r")) + 1]
    try:
        return content.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError:
        raise error(f"{path}: is not UTF-8 text; give {expected} in UTF-8") from None


def folders_in_variable(name: str) -> list[str]:
    """Return the folders that an environment variable names."""
    return [entry for entry in os.environ.get(name, "").split(os.pathsep) if entry]


def image_address(path: Path | str) -> str:
    """Return a PNG, JPEG or SVG image as an address that holds it, for a page that loads nothing else.

    `InputError` if it is missing, another kind of file, or larger than 512 kB.
    """
    expected = "a PNG, JPEG or SVG image"
    content = read_bytes(path, expected, InputError)
    if len(content) > _LARGEST_IMAGE:
        raise InputError(f"{path}: has {len(content) >> 10} kB; give {expected} of at most {_LARGEST_IMAGE >> 10} kB")
    start = content.removeprefix(b"\xef\xbb\xbf").lstrip()
    kind = next((kind for mark, kind in _IMAGES if start.startswith(mark)), None)
    if kind is None or (kind == "svg+xml" and b"<svg" not in content):
        raise InputError(f"{path}: is not an image that a page can show; give {expected}")
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"


def write_file(
    path: Path | str,
    content: bytes | str,
    *,
    comment: str = "",
    inputs: Iterable[Path | str] = (),
    force: bool = False,
) -> None:
    """Write a whole file, or leave what was there untouched; see `write_files`."""
    text = content.encode("utf-8") if isinstance(content, str) else content
    write_files({Path(path): text}, comment=comment, inputs=inputs, force=force)


def write_files(
    files: Mapping[Path, bytes], *, comment: str | None = "", inputs: Iterable[Path | str] = (), force: bool = False
) -> None:
    """Write files that belong together: each as a whole, and none takes its place before all are complete.

    Each ends in a line that says who wrote it. Pipes and devices are written to as they are.

    Args:
        comment: How comments of these files begin, if not as in tables or XML; see `calib.core.base.own_files.signed`.
            None: they get no line; a manifest in their folder says who wrote them.
        inputs: Files that they were made from.
        force: Also replace files that this program did not write, or has read.

    Raises:
        InputError: A file cannot be written, or should not be replaced; nothing was written.
    """
    if comment is None:
        files = {**files, **_manifests(files)}
    with ExitStack() as stack:
        complete = []
        for path, plain in files.items():
            with _explain_errors(path):
                if path.is_dir():
                    raise IsADirectoryError(errno.EISDIR, "is a folder")
                if _is_stream(path):
                    with path.open("ab") as stream:  # appending: standard output may be a file that holds something
                        stream.write(plain)
                    continue
                content = plain if comment is None else signed(plain, comment)
                require_replaceable(path, content, inputs=inputs, force=force)
                target = path.resolve()  # a symbolic link stays one
                clear_leftovers(target.parent)
                temporary = stack.enter_context(new_folder(target.parent)) / target.name
                temporary.write_bytes(content)
                temporary.chmod(_permissions(target, 0o666))
                complete.append((temporary, target))
        for temporary, target in complete:
            with _explain_errors(target):
                temporary.replace(target)
                note_output(target.stat())


def _manifests(files: Mapping[Path, bytes]) -> dict[Path, bytes]:
    """The manifests of the folders of files, pipes and devices not among them."""
    named: dict[Path, dict[str, bytes]] = {}
    for path, content in files.items():
        if not _is_stream(path) and path.parent.is_dir():
            named.setdefault(path.parent, {})[path.name] = content
    return {folder / MANIFEST: manifest_of(folder, contents, ()) for folder, contents in named.items()}


def check_folder(path: Path | str, names: Collection[str] = (), *, force: bool = False) -> None:
    """Raise `InputError` now if these files could not be written to the folder `path` later; see `write_folder`."""
    path = Path(path)
    with _explain_errors(path):
        _check_replaceable(path.resolve())
        for name in names:
            require_replaceable(path / name, force=force)
        parent = path.resolve().parent
        while not parent.exists():
            parent = parent.parent
        for folder in (parent, path) if path.exists() else (parent,):
            with tempfile.TemporaryFile(dir=folder):
                pass


def check_file(path: Path | str, *, inputs: Iterable[Path | str] = (), force: bool = False) -> None:
    """Raise `InputError` now if the file `path` could not be written later; see `write_files`."""
    path = Path(path)
    with _explain_errors(path):
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, "is a folder")
        if _is_stream(path):
            if not os.access(path, os.W_OK):
                raise PermissionError(errno.EACCES, "permission denied")
            return
        require_replaceable(path, inputs=inputs, force=force)
        with tempfile.TemporaryFile(dir=path.resolve().parent):
            pass


def write_folder(
    path: Path | str,
    files: Mapping[str, bytes],
    obsolete: Collection[str] = (),
    *,
    inputs: Iterable[Path | str] = (),
    force: bool = False,
) -> None:
    """Write a folder of files in one go; files of other names that were in it stay, those of `obsolete` names go.

    The new folder is completed next to the old one and takes its place in one step; see `calib.core.base.replacing`. A
    manifest in it says what was written (`calib.core.base.own_files`); `inputs` and `force` are as in `write_files`.
    `InputError` if the folder cannot be written, or a file in it should not be replaced; what was there is untouched.
    """
    path = Path(path).resolve()
    with _explain_errors(path):
        _check_replaceable(path)
        for name in (*files, *obsolete):
            if (path / name).is_dir():
                raise IsADirectoryError(errno.EISDIR, f"{name} in it is a folder")
            require_replaceable(path / name, files.get(name), inputs=inputs, force=force)
        path.parent.mkdir(parents=True, exist_ok=True)
        clear_leftovers(path.parent)
        with new_folder(path.parent) as staging:
            for name, content in {**files, MANIFEST: manifest_of(path, files, obsolete)}.items():
                (staging / name).write_bytes(content)
            staging.chmod(_permissions(path, 0o777))
            replace_folder(staging, path, obsolete)


def _check_replaceable(path: Path) -> None:
    """Raise `OSError` for files, and for folders that must not be exchanged: the current folder and mount points."""
    if path.is_file():
        raise NotADirectoryError(errno.ENOTDIR, "is a file, not a folder")
    if path.suffix.lower() in _FILE_ENDINGS and not path.exists():
        raise InputError(f"{path}: the output is a folder of several files; leave the ending out: '{path.stem}'")
    above = next(folder for folder in path.parents if folder.exists())
    if not above.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, "a part of the path is a file, not a folder")
    here = Path.cwd()
    if path == here or path in here.parents:
        raise OSError(errno.EBUSY, "it holds the current folder; a result needs a folder of its own")
    if os.path.ismount(path):  # Path.is_mount fails where another program replaces it meanwhile
        raise OSError(errno.EBUSY, "it is a mount point; a result needs a folder inside it")


def _is_stream(path: Path) -> bool:
    """Whether a path is a pipe, a device or another program's open file, which no other file can replace."""
    folder = path.absolute().parent
    return path.exists() and (not path.is_file() or folder in _STREAM_FOLDERS or folder.parts[1:2] == ("proc",))


def _permissions(path: Path, default: int) -> int:
    with suppress(FileNotFoundError):
        return path.stat().st_mode & 0o777
    mask = os.umask(0)
    os.umask(mask)
    return default & ~mask


@contextmanager
def _explain_errors(path: Path) -> Iterator[None]:
    try:
        yield
    except (OSError, RuntimeError) as error:  # a link that leads to itself is a RuntimeError
        reason = (getattr(error, "strerror", None) or str(error)).lower()
        raise InputError(f"{path}: cannot be written ({reason}); choose another place for the output") from None
