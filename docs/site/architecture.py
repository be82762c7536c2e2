"""The rooms of the core, the capabilities beside them, and the picture of both. A test holds them against the imports.

A module of the core imports, also inside functions and for type checkers, only from its own room and from rooms of
lower floors; a capability, from the core and from `shared`. What capabilities bring to the core stands in
`calib/capabilities.py`, by name. No modules import each other in a circle.
"""

from __future__ import annotations

import ast
import functools
import textwrap
from dataclasses import dataclass
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

ROOT = Path(__file__).resolve().parents[2]
FRONT = ("calibration", "capabilities", "checking", "cli", "extend")
"""Files above core and capabilities: what users hold, what capabilities bring, the program, what others import."""
BESIDE = ("pictures",)
"""A file of the core on the top floor: who draws."""

_INCHES = 0.08
"""Height of a unit of the picture, in which a line of text is 1.7 high [inch]."""


@dataclass(frozen=True)
class Room:
    """A room of the core, or a capability: folders of `calib`, with the folders in them that are no rooms of their own.

    Attributes:
        name: As CONTRIBUTING.md has it.
        floor: 0 is the lowest; rooms import from lower floors. None: a capability, beside the core.
        folders: Its folders, dotted.
    """

    name: str
    floor: int | None
    folders: tuple[str, ...]

    @property
    def modules(self) -> tuple[str, ...]:
        """Its contents, by the names in the picture."""
        return tuple(
            path.stem
            for module, path in modules().items()
            if path.stem != "__init__" and module not in (*FRONT, *BESIDE) and room_of(module) is self
        )


CORE = (
    Room("Base", 0, ("core.base",)),
    Room("Numerics", 1, ("core.numerics",)),
    Room("Joint terms", 1, ("core.robots.terms",)),
    Room("URDF", 2, ("core.robots.urdf",)),
    Room("Instruments", 2, ("core.instruments",)),
    Room("Robots", 3, ("core.robots",)),
    Room("Data", 4, ("core.data",)),
    Room("Rows", 5, ("core.rows",)),
    Room("Fitting", 6, ("core.fitting",)),
    Room("Judging", 7, ("core.judging",)),
    Room("Calibrating", 8, ("core.calibrating",)),
    Room("Results", 9, ("core.results",)),
    Room("Commands", 10, ("core.commands", "core")),
)
SHARED = Room("Shared", None, ("shared",))
"""Needed by several capabilities, and not by the core; so they import it."""
CAPABILITIES = (
    Room("Starting", None, ("starting",)),
    Room("Planning", None, ("planning",)),
    Room("Motion", None, ("motion",)),
    Room("Studies", None, ("studies",)),
    Room("Compiled", None, ("compiled",)),
    Room("Fleets", None, ("fleets",)),
    Room("Matching", None, ("matching",)),
    Room("Programs", None, ("programs",)),
    Room("Exporting", None, ("exporting",)),
    Room("Photographs", None, ("photographs",)),
    Room("Files", None, ("files",)),
    Room("Printers", None, ("printers",)),
    Room("Redundancy", None, ("redundancy",)),
    Room("Quality", None, ("quality",)),
    SHARED,
)
ROOMS = (*CORE, *CAPABILITIES)


@functools.cache
def modules() -> dict[str, Path]:
    """Every module of `calib` but its front door, with its file."""
    by_name = {}
    for path in sorted((ROOT / "calib").rglob("*.py")):
        parts = path.relative_to(ROOT / "calib").with_suffix("").parts
        name = ".".join(part for part in parts if part != "__init__")
        if name not in ("", "__main__"):
            by_name[name] = path
    return by_name


def room_of(module: str) -> Room:
    """Return the room of a module such as `robots.loops`: that of the innermost folder around it that is one.

    Raises:
        KeyError: Its folder is not a room yet.
    """
    parts = ["core", "commands"] if module in (*FRONT, *BESIDE) else module.split(".")
    for n in range(len(parts), 0, -1):
        for room in ROOMS:
            if ".".join(parts[:n]) in room.folders:
                return room
    raise KeyError(f"calib.{module} has no room: name its folder in docs/site/architecture.py")


@functools.cache
def imported(path: Path) -> set[str]:
    """Modules of `calib` that a file imports anywhere in it, or names in a string to import them when needed."""
    names: set[str] = set()
    known = modules()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "calib":
            base = node.module.removeprefix("calib").removeprefix(".")
            for alias in node.names:
                full = f"{base}.{alias.name}" if base else alias.name
                names.add(full if full in known else base)
        elif isinstance(node, ast.Constant) and str(node.value).startswith("calib."):
            names |= {str(node.value).removeprefix("calib.")} & set(known)
    return names - {""}


def circle(graph: dict[str, set[str]]) -> list[str]:
    """Return modules that import each other in a circle, the first twice; empty where there is none."""
    done: set[str] = set()

    def visit(module: str, way: list[str]) -> list[str]:
        if module in way:
            return [*way[way.index(module) :], module]
        if module in done:
            return []
        for other in sorted(graph.get(module, ())):
            cycle = visit(other, [*way, module])
            if cycle:
                return cycle
        done.add(module)
        return []

    return next((loop for module in sorted(graph) if (loop := visit(module, []))), [])


def picture() -> Figure:
    """Draw the rooms of the core, floor above floor, and the capabilities beside them, with their modules."""
    figure = Figure(figsize=(9.5, 6.4))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.axis("off")
    floors: dict[int | None, list[Room]] = {}
    for room in CORE:
        floors.setdefault(room.floor, []).append(room)
    y = 1.5
    for rooms in floors.values():
        y += _floor(axes, rooms, 2.5, 41.0, y, "#e8eef4") + 1.2
    top, y = y, 1.5
    texts = [_wrapped(room.modules, 49.0) for room in CAPABILITIES]
    natural = [3.4 + 1.7 * (text.count("\n") + 1) for text in texts]
    spare = (top - 1.5 - sum(natural) - 1.2 * len(natural)) / len(natural)
    for room, text, height in zip(CAPABILITIES[::-1], texts[::-1], natural[::-1], strict=True):
        _box(axes, 46.0, y, 50.0, height + spare, room.name, text, "#f4efe0")
        y += height + spare + 1.2
    _box(axes, 2.5, top, 46.0, 5.5, "viz", "viewer, plots, report page", "#fbe9dd")
    _box(axes, 50.0, top, 46.0, 5.5, "medrue", "this robot and the paper's studies", "#e3f1e5")
    top += 5.5
    axes.set(xlim=(0, 98), ylim=(0, top + 1.5))
    figure.set_figheight(_INCHES * (top + 1.5))
    axes.annotate("", (1.6, 1.5), (1.6, top), arrowprops={"arrowstyle": "->", "color": "#767676"})
    axes.annotate("", (43.3, top / 2), (45.8, top / 2), arrowprops={"arrowstyle": "->", "color": "#767676"})
    axes.text(1.4, top / 2, "imports", rotation=90, ha="right", va="center", color="#767676", fontsize=8)
    return figure


def _floor(axes: Axes, rooms: list[Room], x: float, width: float, y: float, colour: str) -> float:
    """Draw rooms side by side, and return their height."""
    least = [3.0 + 1.1 * max(len(room.name), 10) for room in rooms]  # the title fits
    shares = [sum(len(name) + 2 for name in room.modules) for room in rooms]
    spare = (width - sum(least)) / sum(shares)
    widths = [low + spare * share for low, share in zip(least, shares, strict=True)]
    texts = [_wrapped(room.modules, own - 1.0) for room, own in zip(rooms, widths, strict=True)]
    height = 3.4 + 1.7 * max(text.count("\n") + 1 for text in texts)
    for room, own, text in zip(rooms, widths, texts, strict=True):
        _box(axes, x, y, own - 1.0, height, room.name, text, colour)
        x += own
    return height


def _box(axes: Axes, x: float, y: float, width: float, height: float, title: str, text: str, colour: str) -> None:
    style = "round,pad=0.1,rounding_size=0.6"
    axes.add_patch(FancyBboxPatch((x, y), width, height, boxstyle=style, facecolor=colour, edgecolor="#767676"))
    axes.text(x + 0.8, y + height - 0.6, title, weight="bold", va="top", fontsize=10)
    axes.text(x + 0.8, y + height - 2.9, text, va="top", fontsize=8, linespacing=1.2)


def _wrapped(names: tuple[str, ...], width: float) -> str:
    return textwrap.fill(", ".join(names), int((width - 2.0) / 0.7))
