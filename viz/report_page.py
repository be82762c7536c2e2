"""The report of a fit: one page to read and to print, verdict first. No scripts, no requests, all text escaped."""

from __future__ import annotations

import hashlib
import platform
import sys
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from calib import Fit, Robot
from calib.identification.fitted import ErrorSet
from calib.reporting.report_text import notes
from calib.reporting.result_content import error_sets, outlier_rows, parameter_rows, position_uncertainty_table
from calib.version import PROGRAM
from viz.plots import all_plots
from viz.poses import from_fit
from viz.remarks import fit_remarks
from viz.scene import joints_of
from viz.viewer_page import Page

_NAMES = {"cross_validation": "left out in turns"}
_JUDGED_BY = ("validation", "left out in turns", "identification")
_PACKAGES = ("pin", "numpy", "scipy", "yourdfpy", "meshcat", "matplotlib")


@dataclass(frozen=True)
class Accuracy:
    """One line of the accuracy table; numbers in mm as `calib.identification.validation.error_table` gives them."""

    group: str
    state: str
    poses: int
    errors: dict[str, Any]


@dataclass(frozen=True)
class Source:
    """A file that went into the result, and its SHA-256 (or why there is none)."""

    role: str
    path: str
    digest: str


def report_page(fit: Fit, *, command: str = "", created: datetime | None = None) -> Page:
    """Return the report of a fit.

    Args:
        fit: The fit.
        command: Command line that made it.
        created: Time to print; now if not given.
    """
    from jinja2 import Environment, PackageLoader

    environment = Environment(
        loader=PackageLoader("viz", "templates"), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["mm"] = millimetres
    environment.filters["number"] = number
    when = created if created is not None else datetime.now(UTC)
    lines = accuracy(fit)
    return Page(
        environment.get_template("report.html").render(
            fit=fit,
            robot=fit.nominal,
            verdict=fit.verdict,
            headline=headline(lines),
            accuracy=lines,
            worst=worst(fit),
            extent=extent(fit),
            measured_in=measured_in(fit.nominal),
            remarks=fit_remarks(fit),
            plots=all_plots(from_fit(fit), joints_of(fit.nominal)),
            parameters=parameter_rows(fit),
            notes=notes(fit),
            unsure=unsure(fit),
            outliers=left_out(fit) + outlier_rows(fit),
            reach=position_uncertainty_table(fit),
            reach_of="identification" if fit.validation is None else "validation",
            sources=sources(fit),
            versions=versions(),
            program=PROGRAM,
            command=command,
            created=when.strftime("%Y-%m-%d %H:%M UTC"),
        )
    )


def headline(lines: list[Accuracy]) -> tuple[Accuracy, Accuracy]:
    """Return the lines before and after that count: poses that were not used, where there are any."""
    by_name = {(line.group, line.state): line for line in lines}
    group = next(name for name in _JUDGED_BY if (name, "after") in by_name)
    return by_name[group, "before"], by_name[group, "after"]


def judged_by(fit: Fit) -> ErrorSet:
    """Return the errors that count, as in `headline`."""
    sets = {_NAMES.get(name, name): found for name, found in error_sets(fit)}
    return next(sets[name] for name in _JUDGED_BY if name in sets)


def worst(fit: Fit) -> str:
    """Return where the robot is still worst: the pose with the largest error after calibration, and its place."""
    found = judged_by(fit)
    pose, target = np.unravel_index(np.argmax(np.linalg.norm(found.after, axis=2)), found.after.shape[:2])
    place = ", ".join(
        f"{axis} {1e3 * value:.0f}" for axis, value in zip("xyz", found.data.positions[pose, target], strict=True)
    )
    point = f", point {fit.nominal.target_names[target]}" if len(fit.nominal.target_names) > 1 else ""
    return f"pose {found.data.names[pose]}{point}, at {place} mm".replace("-", "−")


def extent(fit: Fit) -> str:
    """Return the box [mm] in which the targets were measured."""
    sets = [fit.identification, *([] if fit.validation is None else [fit.validation])]
    points = 1e3 * np.concatenate([found.data.positions.reshape(-1, 3) for found in sets])
    ranges = zip("xyz", points.min(axis=0), points.max(axis=0), strict=True)
    return ", ".join(f"{axis} {low:.0f} to {high:.0f}" for axis, low, high in ranges).replace("-", "−") + " mm"


def measured_in(robot: Robot) -> str:
    """Return what the frame of measured coordinates is called: by a link's name only where it is that link's frame."""
    base = robot.description.base
    is_link = base.pose == "known" and not np.any([base.xyz, base.rpy])
    return base.frame if is_link else "the measurement frame"


def accuracy(fit: Fit) -> list[Accuracy]:
    """Return the accuracy table: each set before and after calibration."""
    lines = [
        Accuracy(_NAMES.get(group, group), state, len(found.data), dict(errors))
        for group, found in error_sets(fit)
        for state, errors in found.table().items()
    ]
    if fit.with_all is not None:
        found = fit.with_all.identification
        lines.append(Accuracy("with outliers", "after", len(found.data), dict(found.table()["after"])))
    return lines


def unsure(fit: Fit) -> dict[str, list[str]]:
    """Return the names of parameters that the measurements do not decide, by status."""
    found: dict[str, list[str]] = {}
    for row in parameter_rows(fit):
        if row["status"] not in ("identified", "placed"):
            found.setdefault(str(row["status"]), []).append(str(row["name"]))
    return found


def left_out(fit: Fit) -> list[dict[str, Any]]:
    """Return the outliers that were left out of the fit, in the form of `outlier_rows`."""
    if fit.with_all is None:
        return []
    names = fit.with_all.identification.data.names
    return [
        {
            "set": "left out",
            "pose": names[found.pose],
            "target": found.target,
            "distance": 1e3 * found.distance,
            "over_noise": found.studentised,
            "leverage": found.leverage,
        }
        for found in fit.excluded
    ]


def sources(fit: Fit) -> list[Source]:
    """Return the files that went into the fit, with their hashes; the URDF's is of what was read."""
    result = [_source("Robot description", fit.nominal.path)]
    if fit.nominal.urdf.path != fit.nominal.path:
        result.append(Source("URDF", fit.nominal.urdf.path, hashlib.sha256(fit.nominal.urdf.source).hexdigest()))
    result.append(_source("Measurements to identify with", fit.identification.data.path))
    if fit.validation is not None:
        same = fit.validation.data.path == fit.identification.data.path
        result.append(
            _source(
                "Measurements to validate with" + (", held out of the same file" if same else ""),
                fit.validation.data.path,
            )
        )
    return result


def _source(role: str, path: str) -> Source:
    try:
        return Source(role, path, hashlib.sha256(Path(path).read_bytes()).hexdigest())
    except OSError:
        return Source(role, path or "not from a file", "no file to hash")


def versions() -> list[tuple[str, str]]:
    """Return the programs that took part, and their versions."""
    found = [("Python", platform.python_version())]
    for package in _PACKAGES:
        try:
            found.append((package, version(package)))
        except PackageNotFoundError:
            found.append((package, "unknown"))
    return [*found, ("system", f"{platform.system()} {platform.machine()}")]


def command_line() -> str:
    """Return the command line of this process if it is one of our programs, else nothing."""
    import shlex

    name = Path(sys.argv[0]).name if sys.argv else ""
    if name == "__main__.py":
        return shlex.join(["python", "-m", Path(sys.argv[0]).parent.name, *sys.argv[1:]])
    return shlex.join([name, *sys.argv[1:]]) if name in ("calib", "medrue") else ""


def millimetres(value: float) -> str:
    """Format a length in mm with three significant digits; a dash for unknown."""
    size = abs(value)
    return number(value, 4 if size < 0.1 else 3 if size < 1 else 2 if size < 10 else 1)


def number(value: float, decimals: int = 4) -> str:
    """Format a number; a dash for unknown, and no sign before a zero."""
    if not np.isfinite(value):
        return "–"
    text = f"{value:.{decimals}f}"
    return text.replace("-", "−" if float(text) else "")
