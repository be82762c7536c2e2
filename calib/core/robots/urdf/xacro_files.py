"""Expanding xacro files of strangers: in a process of its own, with little time and memory, which reads few files.

Expressions of xacro are Python, and may compute for ever (`${9**9**9}`), read what they like (`xacro.load_yaml`) and
say it in an error. So the child process has no variables of the environment but those that say where packages are, it
ends after some seconds, and opens only files of the package that the xacro file is in, of packages that are installed,
and of Python. What goes wrong is told by its kind and place; no message quotes what a file holds.

The package is the folder around the file that has a `package.xml`; without one, the folder above the file's own.

When it fails. This is no prison: expressions can do what Python can. It keeps mistakes short, and what others may not
read out of messages and robots.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from calib.core.base.errors import UrdfError

_SECONDS = 20
_MEMORY = 2**31  # bytes
_PACKAGES = ("AMENT_PREFIX_PATH", "CMAKE_PREFIX_PATH", "COLCON_PREFIX_PATH", "ROS_PACKAGE_PATH", "ROS_DISTRO")
_SYSTEM = ("PATH", "LD_LIBRARY_PATH", "SYSTEMROOT", "VIRTUAL_ENV")
_MISSING, _FAILED = 3, 4
_FORBIDDEN = ("subprocess.", "os.system", "os.exec", "os.posix_spawn", "os.spawn", "socket.")
_IDENTIFIER = re.compile(r"[A-Za-z]\w{0,60}")
_QUOTED = re.compile(r"'([^']*)'|[Uu]ndefined substitution argument (\S+)|unknown macro name: (\S+)")


def expanded(path: Path | str) -> bytes:
    """Return the URDF that a xacro file stands for, by the package xacro, which not everybody has.

    Raises:
        UrdfError: The package is missing, or the file cannot be expanded.
    """
    elsewhere = f"or expand it elsewhere: xacro {path} > robot.urdf"
    environment = {name: os.environ[name] for name in (*_PACKAGES, *_SYSTEM) if name in os.environ}
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, sys.path))
    command = [sys.executable, "-P", "-X", "utf8", "-m", __name__, str(Path(path).resolve())]
    try:
        done = subprocess.run(command, capture_output=True, timeout=_SECONDS, env=environment, check=False)
    except subprocess.TimeoutExpired:
        raise UrdfError(f"{path}: xacro does not end within {_SECONDS} s; correct it, {elsewhere}") from None
    if done.returncode == _MISSING:
        raise UrdfError(
            f"{path}: is a xacro file, and the package that expands them is not installed: pip install xacro;"
            f" {elsewhere}"
        )
    if done.returncode:
        last = done.stderr.decode("utf-8", "replace").strip().splitlines()[-1:]
        said = last[0] if done.returncode == _FAILED and last else "it ended without a word"
        raise UrdfError(f"{path}: xacro cannot expand it ({said}); correct it, {elsewhere}")
    return done.stdout


def _main(path: str) -> int:
    """Write the URDF to standard output, or the kind of an error to standard error; return the exit code."""
    try:
        import xacro
    except ImportError:
        return _MISSING
    _limit_memory()
    sys.addaudithook(_guard(Path(path)))
    try:
        text: bytes = xacro.process_file(path).toprettyxml(indent="  ", encoding="utf-8")
    except BaseException as error:  # of xacro, of the XML parser, of expressions in the file
        sys.stderr.write(f"\n{_kind(error)}\n")
        return _FAILED
    sys.stdout.buffer.write(text)
    return 0


def _kind(error: BaseException) -> str:
    """What went wrong, with the one name that may be quoted: no text of a file, and none of another package."""
    causes: list[BaseException] = [error]
    while (cause := getattr(causes[-1], "exc", None) or causes[-1].__cause__ or causes[-1].__context__) is not None:
        causes.append(cause)
    outside = next((cause for cause in causes if isinstance(cause, _OutsideError)), None)
    if outside is not None:
        return str(outside)
    missing = next((cause.name for cause in causes if isinstance(cause, ImportError) and cause.name), None)
    if missing is not None:
        return f"the Python package {missing} is not installed"
    if any(isinstance(cause, MemoryError) for cause in causes):
        return "it takes more than 2 GB of memory"
    if "environment variable" in str(error):
        return "it needs a variable of the environment, which no robot depends on here"
    line = next((f"line {cause.lineno}: " for cause in causes if hasattr(cause, "lineno")), "")
    quoted = _QUOTED.search(str(error))
    name = next(filter(None, quoted.groups()), "") if quoted else ""
    if name and all(map(_IDENTIFIER.fullmatch, name.split(":"))):
        return f"{line}it has no value or meaning for '{name}'"
    return f"{line}an expression, a macro or the XML is wrong"


class _OutsideError(Exception):
    """An expression asked for what is not its own."""


def _guard(path: Path) -> Callable[[str, tuple[object, ...]], None]:
    """A hook of Python that refuses to open files outside packages, and to start programs."""
    around = next((folder for folder in path.parents if (folder / "package.xml").is_file()), None)
    own = around or (path.parents[1] if len(path.parents) > 2 else path.parent)
    installed = [entry for name in _PACKAGES for entry in os.environ.get(name, "").split(os.pathsep) if entry]
    python = [sys.prefix, sys.base_prefix, *sys.path]
    folders = [os.path.realpath(folder) for folder in (str(own), *installed, *python) if folder]

    def check(event: str, given: tuple[object, ...]) -> None:
        if event == "open" and isinstance(given[0], (str, bytes, Path)):
            file = str(Path(os.fsdecode(given[0])).resolve())
            if not any(file == folder or file.startswith(folder + os.sep) for folder in folders):
                raise _OutsideError("it reads a file outside of its package")
        elif event.startswith(_FORBIDDEN):
            raise _OutsideError("it starts a program, or asks the network")

    return check


def _limit_memory() -> None:
    try:
        import resource
    except ImportError:  # not on Windows
        return
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    resource.setrlimit(resource.RLIMIT_CPU, (_SECONDS, _SECONDS))


if __name__ == "__main__":
    sys.exit(_main(sys.argv[1]))
