"""Kinematic calibration of any robot with a URDF, closed loops included, on Pinocchio.

Names are imported when they are first used, so that a program that needs few of them starts quickly. `__init__.pyi`
lists them.
"""

import ast
from importlib import import_module
from pathlib import Path
from typing import Any

_LIST = ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
_HOMES = {
    alias.name: statement.module
    for statement in _LIST.body
    if isinstance(statement, ast.ImportFrom) and statement.module
    for alias in statement.names
}

__all__ = sorted(_HOMES)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return import_module("calib.core.base.version").VERSION
    if name not in _HOMES:
        if name.startswith("_"):
            raise AttributeError(name)
        raise import_module("calib.core.base.other_words").unknown_name_error(name, __all__)
    value = globals()[name] = getattr(import_module(_HOMES[name]), name)
    return value


def __dir__() -> list[str]:
    return __all__
