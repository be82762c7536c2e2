"""The Python reference: public names, one page for each task, and the derivations that other pages cite.

Everything else is documented in the source.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
FOLDER = "reference/api"
PACKAGES = ("calib", "viz", "medrue")
STEPS = {
    "A robot and its measurements": (
        "load",
        "robot",
        "read_measurements",
        "read_poses",
        "as_measurements",
        "as_poses",
        "read_parameters",
        "Robot",
        "Measurements",
        "Poses",
    ),
    "Before measuring": ("sample", "check", "select", "simulate", "study", "Assessment", "Selection", "Study"),
    "Calibrating": ("fit", "load_result", "Watch", "Calibration", "Fit", "LoadedResult", "Progress"),
    "Judging": ("verify", "compare", "fleet", "Acceptance", "ResultComparison", "Fleet"),
    "Using the calibrated robot": (
        "predict",
        "solve",
        "compensate",
        "export",
        "Goals",
        "Solution",
        "Compensation",
        "Holds",
    ),
    "Parametrisations of your own": ("Parametrisation", "Parameter", "Origin", "twist_of_edit"),
}
"""Names of `calib` by task, in the order of use; functions before the classes that they return."""
_INTRO = "For anyone who programs in Python: at the end you know arguments, units and errors of each of these names."
_CITED = re.compile(r"reference/api/((?:calib|viz|medrue)[\w.]*)\.md")


def by_task() -> dict[str, list[str]]:
    """Return the public names of `calib` by task, each once: those of `STEPS`, then what else there is, then errors."""
    names = importlib.import_module("calib").__all__
    steps = {step: [name for name in told if name in names] for step, told in STEPS.items()}
    rest = [name for name in names if not any(name in told for told in steps.values())]
    errors = [name for name in rest if name.endswith("Error")]
    more = {"More": [name for name in rest if name not in errors], "Errors": errors}
    return {step: told for step, told in {**steps, **more}.items() if told}


def cited() -> list[str]:
    """Return the modules whose derivations other pages link to."""
    pages = (*DOCS.rglob("*.md"), ROOT / "CONTRIBUTING.md")
    return sorted({name for page in pages for name in _CITED.findall(page.read_text(encoding="utf-8"))})


def modules(package: str) -> list[str]:
    """Return dotted names of the public modules of a package, found on disk so that none is forgotten."""
    names = []
    for path in sorted((ROOT / package).rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        if parts[-1] == "__init__":
            parts = parts[:-1]
        if not any(part.startswith("_") for part in parts):
            names.append(".".join(parts))
    return names


def source(module: str) -> str:
    """Return the text of a module."""
    path = ROOT.joinpath(*module.split("."))
    path = path / "__init__.py" if path.is_dir() else path.parent / f"{path.name}.py"
    return path.read_text(encoding="utf-8")


def summary(module: str) -> str:
    """Return the first sentence of a module's docstring."""
    text = ast.get_docstring(ast.parse(source(module))) or ""
    return " ".join(text.split("\n\n")[0].split())


def navigation() -> list[object]:
    """Return the entries of the navigation."""
    tasks = [{title: f"{FOLDER}/{_slug(title)}.md"} for title in _tables()]
    return [f"{FOLDER}/index.md", *tasks, {"Derivations": [{name: f"{FOLDER}/{name}.md"} for name in cited()]}]


def pages() -> dict[str, str]:
    """Return path in docs/ and Markdown text of every page."""
    result = {f"{FOLDER}/index.md": _index()}
    for title, (package, names) in _tables().items():
        entries = "\n".join(_entry(package, name) for name in names)
        result[f"{FOLDER}/{_slug(title)}.md"] = f"# {title}\n\n{_INTRO}\n\n{_names(package, names)}\n{entries}"
    for name in cited():  # the derivation alone: what is in the module is in its source
        result[f"{FOLDER}/{name}.md"] = f"---\ntitle: {name}\n---\n\n::: {name}\n    options:\n      members: false\n"
    return result


def _tables() -> dict[str, tuple[str, list[str]]]:
    """Package and names of each page."""
    others = {f"Python names of {package}": package for package in PACKAGES[1:]}
    own = {title: ("calib", names) for title, names in by_task().items()}
    return own | {title: (package, importlib.import_module(package).__all__) for title, package in others.items()}


def _index() -> str:
    parts = [
        "# Python reference\n\nFor anyone who calls the program from Python: at the end you know the public names of a"
        " task, with their arguments, units and errors. Names of other modules may change; their documentation is in"
        " the source.\n"
    ]
    for title, (package, names) in _tables().items():
        parts.append(f"## [{title}]({_slug(title)}.md)\n\n{_names(package, names)}")
    rows = [f"| [`{name}`]({name}.md) | {_cell(summary(name))} |" for name in cited()]
    parts.append("\n".join(["## Derivations\n", "| module | what it derives |", "|---|---|", *rows, ""]))
    return "\n".join(parts)


def _entry(package: str, name: str) -> str:
    options = (
        "    options:\n      heading_level: 2\n      show_root_toc_entry: true\n      show_root_full_path: false\n"
    )
    inherited = "".join(f"        - {member}\n" for member in _inherited(package, name))
    more = f"      inherited_members:\n{inherited}" if inherited else ""
    return f"::: {_place(package, name)}\n{options}{more}"


def _inherited(package: str, name: str) -> list[str]:
    """Return what a class has from bases of the project that have no entry of their own."""
    thing, public = getattr(importlib.import_module(package), name), importlib.import_module(package).__all__
    if not inspect.isclass(thing) or issubclass(thing, Exception):
        return []
    own = [parent for parent in thing.__mro__[1:] if parent.__module__.startswith(f"{package}.")]
    bases = [parent for parent in own if parent.__name__ not in public]
    known = {member for parent in bases for member in vars(parent) if not member.startswith("_")}
    return sorted(known - set(vars(thing)))


def _names(package: str, names: list[str]) -> str:
    rows = [f"| [`{package}.{name}`][{_place(package, name)}] | {_first_line(package, name)} |" for name in names]
    return "\n".join(["| name | what it is |", "|---|---|", *rows, ""])


def _place(package: str, name: str) -> str:
    """Module that defines an object, and has its documentation."""
    thing = getattr(importlib.import_module(package), name)
    return f"{thing.__module__}.{thing.__qualname__}"


def _first_line(package: str, name: str) -> str:
    return _cell((inspect.getdoc(getattr(importlib.import_module(package), name)) or "").split("\n\n")[0])


def _slug(title: str) -> str:
    return title.lower().replace(" ", "-")


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")
