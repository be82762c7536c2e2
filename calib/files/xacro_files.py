"""Expansion of untrusted xacro files, in a separate process with little time and memory that reads few files.

Expressions of xacro are Python, and may compute for ever (`${9**9**9}`), read any file (`xacro.load_yaml`) and quote it
in an error. So the child process only has the environment variables of package folders, it ends after some seconds, and
opens only files of the xacro file's package, of installed packages, and of Python. An error is reported by its kind and
place; no message quotes the content of a file.

The package is the folder around the file that has a `package.xml`; without one, the folder above the file's own.
`$(find NAME)` is the package NAME: the one around the file, one beside that, or one in the folders of ROS, which are
`ROS_PACKAGE_PATH`, and `share` of `AMENT_PREFIX_PATH`. No ROS is needed.

When it fails. This is no sandbox: expressions can do what Python can. It limits mistakes, and keeps private content out
of messages and robots.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from calib.core.base.errors import UrdfError
from calib.core.base.files import folders_in_variable

_SECONDS = 20
_MEMORY = 2**31  # bytes
_PACKAGES = ("AMENT_PREFIX_PATH", "CMAKE_PREFIX_PATH", "COLCON_PREFIX_PATH", "ROS_PACKAGE_PATH", "ROS_DISTRO")
_SYSTEM = ("PATH", "LD_LIBRARY_PATH", "SYSTEMROOT", "VIRTUAL_ENV")
_MISSING, _FAILED = 3, 4
_DEEP = 4  # depth to which packages are searched below ROS_PACKAGE_PATH, or beside a package
_NAME = re.compile(r"<name>\s*([^<\s]+)\s*</name>")
_FORBIDDEN = ("subprocess.", "os.system", "os.exec", "os.posix_spawn", "os.spawn", "socket.")
_IDENTIFIER = re.compile(r"[A-Za-z]\w{0,60}")
_FILE = re.compile(r"[A-Za-z][\w.-]{0,60}\.(?:xacro|yaml|yml)")
_QUOTED = re.compile(
    r"'([^']*)'|[Uu]ndefined substitution argument (\S+)|unknown macro name: (\S+)|Invalid parameter \"(\w+)\""
)
_EMPTY = re.compile(r"<xacro:arg\s+name=\"([A-Za-z]\w*)\"\s+default=\"\"")


def read_xacro(path: str, _: bytes, arguments: Mapping[str, str]) -> tuple[bytes, None]:
    """Return the URDF of a xacro file, expanded by the package xacro; `UrdfError` if that is missing or fails."""
    given = [f"{name}:={value}" for name, value in arguments.items()]
    elsewhere = f"or expand it on a computer with ROS: {' '.join(['xacro', path, *given])} > robot.urdf"
    environment = {name: os.environ[name] for name in (*_PACKAGES, *_SYSTEM) if name in os.environ}
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, sys.path))
    command = [sys.executable, "-P", "-X", "utf8", "-m", __name__, str(Path(path).resolve()), *given]
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
        message = last[0] if done.returncode == _FAILED and last else "it ended without an error message"
        raise UrdfError(f"{path}: xacro cannot expand it ({message}); correct it, {elsewhere}")
    return done.stdout, None


def _main(path: str, *given: str) -> int:
    """Write the URDF to standard output, or the kind of an error to standard error; return the exit code."""
    try:
        import xacro
        from xacro import substitution_args
    except ImportError:
        return _MISSING
    _limit_memory()
    packages = _Packages(Path(path))
    substitution_args._eval_find = packages.find
    sys.addaudithook(_guard(packages))
    os.environ.clear()  # so that expressions cannot read it
    values = dict(argument.split(":=", 1) for argument in given)
    try:
        text: bytes = _process(xacro, path, values).toprettyxml(indent="  ", encoding="utf-8")
    except BaseException as error:  # errors of xacro, of the XML parser, of expressions in the file
        sys.stderr.write(f"\n{_kind(error)}\n")
        return _FAILED
    sys.stdout.buffer.write(text)
    return 0


def _process(xacro: Any, path: str, values: dict[str, str]) -> Any:
    """The expanded document; `_OutsideError` names all arguments without a value."""
    lacking: dict[str, str] = {}
    while True:
        try:
            document = xacro.process_file(path, mappings=values | lacking)
        except Exception as error:
            name = next((m[2] for cause in _causes(error) if (m := _QUOTED.search(str(cause))) and m[2]), None)
            if name is None or name in lacking or not _IDENTIFIER.fullmatch(name):
                if lacking:
                    raise _OutsideError(_without_value(lacking)) from None
                missing = next((cause for cause in _causes(error) if isinstance(cause, FileNotFoundError)), None)
                if missing is not None:
                    raise _OutsideError(_without_file(path, str(missing.filename), values)) from None
                raise
            lacking[name] = name  # to find further missing arguments
            continue
        if lacking:
            raise _OutsideError(_without_value(lacking))
        return document


def _without_value(names: Mapping[str, str]) -> str:
    return f"no value for {', '.join(names)}: calib init FILE {' '.join(f'--xacro {name}:=VALUE' for name in names)}"


def _without_file(path: str, missing: str, values: Mapping[str, str]) -> str:
    """Advice on a missing file, whose name often contains a missing argument."""
    text = Path(path).read_text(encoding="utf-8", errors="replace")
    empty = [name for name in dict.fromkeys(_EMPTY.findall(text)) if not values.get(name)]
    given = f"; these arguments are empty: {', '.join(empty)}; give them: --xacro {empty[0]}:=VALUE" if empty else ""
    name = Path(missing).name
    called = f" ({name})" if _FILE.fullmatch(name) else ""
    return f"a file that it includes is not there{called}{given}"


def _causes(error: BaseException) -> list[BaseException]:
    causes: list[BaseException] = [error]
    while (cause := getattr(causes[-1], "exc", None) or causes[-1].__cause__ or causes[-1].__context__) is not None:
        causes.append(cause)
    return causes


def _kind(error: BaseException) -> str:
    """The kind of an error. It quotes at most one name, and no other text of a file or of another package."""
    causes = _causes(error)
    outside = next((cause for cause in causes if isinstance(cause, _OutsideError)), None)
    if outside is not None:
        return str(outside)
    missing = next((cause.name for cause in causes if isinstance(cause, ImportError) and cause.name), None)
    if missing is not None:
        return f"the Python package {missing} is not installed"
    if any(isinstance(cause, MemoryError) for cause in causes):
        return "it takes more than 2 GB of memory"
    if "environment variable" in str(error):
        return "it needs an environment variable; robots here may not depend on one"
    line = next((f"line {cause.lineno}: " for cause in causes if hasattr(cause, "lineno")), "")
    quoted = _QUOTED.search(str(error))
    name = next(filter(None, quoted.groups()), "") if quoted else ""
    if name and all(map(_IDENTIFIER.fullmatch, name.split(":"))):
        return f"{line}it has no value or meaning for '{name}'"
    return f"{line}an expression, a macro or the XML is wrong"


class _OutsideError(Exception):
    """An expression leaves its bounds, or uses a name without a value."""


class _Packages:
    """Folders of packages: the one around a file, and others once they are `found`, by name."""

    def __init__(self, path: Path) -> None:
        around = next((folder for folder in path.parents if (folder / "package.xml").is_file()), None)
        self.own = around or (path.parents[1] if len(path.parents) > 2 else path.parent)
        self.found: dict[str, str] = {}
        self._prefixes, self._roots = map(folders_in_variable, ("AMENT_PREFIX_PATH", "ROS_PACKAGE_PATH"))

    def find(self, name: str) -> str:
        """Return the folder of a package."""
        if name not in self.found:
            folder = next((folder for folder in self._folders(name) if _is_package(folder, name)), None)
            if folder is None:
                raise _OutsideError(
                    f"no package '{name}' around or beside the file, nor in ROS_PACKAGE_PATH or AMENT_PREFIX_PATH; put"
                    " the package beside it"
                )
            self.found[name] = os.path.realpath(folder)
        return self.found[name]

    def _folders(self, name: str) -> Iterator[Path]:
        yield from (folder for folder in (self.own, *self.own.parents) if (folder / "package.xml").is_file())
        yield from (Path(prefix) / "share" / name for prefix in self._prefixes)
        for root in (*list(self.own.parents)[:2], *map(Path, self._roots)):
            yield root / name
            for depth in range(_DEEP):
                yield from (file.parent for file in sorted(root.glob("*/" * depth + "package.xml")))


def _is_package(folder: Path, name: str) -> bool:
    """Whether a folder is the package of this name: by its package.xml, or without one by the folder's name."""
    file = folder / "package.xml"
    if not file.is_file():
        return folder.name == name and folder.is_dir()
    match = _NAME.search(file.read_text(encoding="utf-8", errors="replace"))
    return match is not None and match[1] == name


def _guard(packages: _Packages) -> Callable[[str, tuple[object, ...]], None]:
    """A hook of Python that refuses to open files outside packages, and to start programs."""
    installed = [entry for name in _PACKAGES for entry in folders_in_variable(name)]
    python = [sys.prefix, sys.base_prefix, *sys.path]
    folders = [os.path.realpath(folder) for folder in (str(packages.own), *installed, *python) if folder]

    def check(event: str, given: tuple[object, ...]) -> None:
        if event == "open" and isinstance(given[0], (str, bytes, Path)):
            file = str(Path(os.fsdecode(given[0])).resolve())
            own = file.endswith(os.sep + "package.xml")
            if not own and not any(
                file == folder or file.startswith(folder + os.sep) for folder in (*folders, *packages.found.values())
            ):
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
    sys.exit(_main(*sys.argv[1:]))
