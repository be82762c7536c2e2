"""The Python reference: one page for each module, and a first page that says which names to start from.

Modules stand under their package, and within `calib` under their room (the folder), floor above floor.
"""

from __future__ import annotations

import ast
import importlib
import inspect
from pathlib import Path

from architecture import ROOMS, room_of

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = {
    "calib": "the engine, for any robot",
    "viz": "pictures of what calib knows",
    "medrue": "MedRUE, and the studies of the paper",
}
FOLDER = "reference/api"
STEPS = {
    "A robot and its measurements": (
        "load",
        "robot",
        "read_measurements",
        "read_poses",
        "as_measurements",
        "as_poses",
        "read_parameters",
    ),
    "Before measuring": ("sample", "check", "select", "simulate", "study"),
    "Calibrating": ("fit", "load_result", "Watch"),
    "Judging": ("verify", "compare"),
    "Using the calibrated robot": ("predict", "solve", "compensate", "export"),
    "Parametrisations of your own": ("Parametrisation", "Parameter", "Origin", "twist_of_edit"),
}
"""Names of `calib` in the order in which they are used; what else there is follows by its kind."""


def modules(package: str) -> list[str]:
    """Dotted names of the public modules of a package, found on disk so that none is forgotten."""
    names = []
    for path in sorted((ROOT / package).rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        if parts[-1] == "__init__":
            parts = parts[:-1]
        if not any(part.startswith("_") for part in parts):
            names.append(".".join(parts))
    return names


def rooms() -> dict[str, list[str]]:
    """Modules of `calib` but its front door, by the name of their room, floor above floor."""
    names = [name for name in modules("calib") if name != "calib"]
    return {room.name: [name for name in names if room_of(name.partition(".")[2]) is room] for room in ROOMS}


def source(module: str) -> str:
    """Text of a module."""
    path = ROOT.joinpath(*module.split("."))
    path = path / "__init__.py" if path.is_dir() else path.parent / f"{path.name}.py"
    return path.read_text(encoding="utf-8")


def summary(module: str) -> str:
    """First sentence of a module's docstring."""
    text = ast.get_docstring(ast.parse(source(module))) or ""
    return " ".join(text.split("\n\n")[0].split())


def navigation() -> list[object]:
    """Entries of the navigation; below a room or a package a module goes by the last part of its name."""
    by_room = [{room: [_entry(name) for name in names]} for room, names in rooms().items()]
    others = [{package: [_entry(name) for name in modules(package)]} for package in PACKAGES if package != "calib"]
    return [f"{FOLDER}/index.md", {"calib": [_entry("calib"), *by_room]}, *others]


def _entry(module: str) -> dict[str, str]:
    return {module.rpartition(".")[2]: f"{FOLDER}/{module}.md"}


def pages() -> dict[str, str]:
    """Path in docs/ and Markdown text of every page."""
    result = {f"{FOLDER}/index.md": _index()}
    for package in PACKAGES:
        for name in modules(package):
            result[f"{FOLDER}/{name}.md"] = f"---\ntitle: {name}\n---\n\n::: {name}\n"
    return result


def _index() -> str:
    parts = ["# Python reference\n\nWhat to start from; every module has a page of its own.\n"]
    parts.append("## From `calib`, in the order of use\n")
    parts += [f"### {step}\n\n{_names('calib', names)}" for step, names in by_use("calib").items()]
    parts.append(f"## From `viz`\n\n{_names('viz', importlib.import_module('viz').__all__)}")
    for package, what in PACKAGES.items():
        parts.append(f"## Modules of `{package}`: {what}\n")
        if package == "calib":
            parts.append(
                "Each folder is a room; rooms stand on floors, the lowest first, and import only from lower ones"
                " ([picture](../../contributing.md#architecture)).\n"
            )
            parts += [f"### {room}\n\n{_module_table(names)}" for room, names in rooms().items()]
        else:
            parts.append(_module_table(modules(package)))
    return "\n".join(parts).replace("|---|---|\n\n", "|---|---|\n")


def by_use(package: str) -> dict[str, list[str]]:
    """Public names of a package by when they are used, each once: the steps, then what else there is by its kind."""
    module = importlib.import_module(package)
    steps = {step: [name for name in names if name in module.__all__] for step, names in STEPS.items()}
    rest = [name for name in module.__all__ if not any(name in names for names in steps.values())]
    errors = [name for name in rest if name.endswith("Error")]
    classes = [name for name in rest if name[0].isupper() and name not in errors]
    more = [name for name in rest if name not in errors and name not in classes]
    kinds = {"More": more, "What these take and return": classes, "Errors": errors}
    return {step: names for step, names in {**steps, **kinds}.items() if names}


def _names(package: str, names: list[str]) -> str:
    module = importlib.import_module(package)
    rows = [f"| [`{package}.{name}`][{_place(module, name)}] | {_first_line(module, name)} |" for name in names]
    return "\n".join(["| name | what it is |\n|---|---|", *rows]) + "\n"


def _module_table(names: list[str]) -> str:
    rows = [f"| [`{name}`]({name}.md) | {_cell(summary(name))} |" for name in names]
    return "\n".join(["| module | what it is about |\n|---|---|", *rows]) + "\n"


def _place(module: object, name: str) -> str:
    """Where an object is defined, which is where its documentation stands."""
    thing = getattr(module, name)
    return f"{thing.__module__}.{thing.__qualname__}"


def _first_line(module: object, name: str) -> str:
    return _cell((inspect.getdoc(getattr(module, name)) or "").split("\n\n")[0])


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")
