"""The report of a fit, for the screen and for paper: the answer first, then robot, errors and plots.

The page makes no requests, runs only its own scripts, and escapes all text.
"""

from __future__ import annotations

import hashlib
import platform
import re
import shlex
import sys
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup, escape

from calib import Fit, Robot
from calib.core.base.version import PROGRAM
from calib.core.base.words import sentence
from calib.core.judging.verdict import judge
from calib.core.results.sections.accuracy import accuracy_grids
from calib.core.results.sections.budget import budget_grid, budget_table
from calib.core.results.sections.details import details
from calib.core.results.sections.determination import position_uncertainty_table, unsure
from calib.core.results.sections.files_held import files_grid
from calib.core.results.sections.grid import GridNumber
from calib.core.results.sections.noise import noise_found
from calib.core.results.sections.parameters import parameter_grid
from viz.charts import Charts
from viz.error_charts import conditions, coverage, error_charts, page_rows
from viz.joint_charts import corrections, dials
from viz.judgement import following_words, robot_to_load
from viz.page_parts import chart_parts, places
from viz.pose_sources import from_fit
from viz.remarks import fit_remarks, record, signatures
from viz.report_tables import Headline, extent, outlier_grid, tolerance_of, worst, worst_joint
from viz.result_charts import file_worth_chart, joint_shares, parameters, waterfall
from viz.scene import ViewerScene, scene_of_fit
from viz.scene_data import mean_distances
from viz.viewer_page import ViewerPage, scene_page, templates

if TYPE_CHECKING:
    from jinja2 import Environment

_PACKAGES = ("pin", "numpy", "scipy", "trimesh", "meshcat", "bokeh")
_DECIMALS, _MOST_DECIMALS = 4, 9
_LONGEST_LABEL = 24
_BESIDE = 2  # plots of the first part of readings beside the robot in space


def report_page(
    fit: Fit,
    *,
    command: str = "",
    created: datetime | None = None,
    viewer: str = "",
    logo: str = "",
    scene: ViewerScene | None = None,
) -> ViewerPage:
    """Return the report of a fit, made by a command line.

    `created` is printed (default: now); `viewer` is the file beside the page, to link to; `logo` is an address from
    `calib.core.base.files.image_address`; `scene` is the fit's, if it exists already.
    """
    shown = scene_of_fit(fit) if scene is None and fit.assembles else scene
    headline, table, budget, claim = Headline.from_fit(fit), from_fit(fit), budget_table(fit), judge(fit).claim
    frame = "" if shown is None else scene_page(shown, embedded=True).html
    return printed_page(
        "report.html",
        _charts(fit, shown),
        command,
        created,
        frame,
        fit=fit,
        robot=fit.nominal,
        verdict=judge(fit),
        following=following_words(fit, command).partition(": "),
        headline=headline,
        space=_space(shown, headline.part.name),
        accuracy=accuracy_grids(fit),
        noise=noise_found(fit),
        worth=files_grid(fit),
        budget=budget_grid(fit),
        advice="" if budget is None else budget["advice"],
        worst=worst(fit),
        worst_joint=worst_joint(fit),
        extent=extent(table),
        to_load=robot_to_load(fit),
        measured_in=frame_name(fit.nominal),
        remarks=fit_remarks(fit, beside_record=True),
        record=record(fit),
        signatures=signatures(fit),
        tolerance=tolerance_of(fit),
        logo=logo,
        claim="" if claim is None else claim.words,
        parameters=parameter_grid(fit),
        has_space=shown is not None,
        n_beside=0 if shown is None else _BESIDE,
        notes=details(fit, brief=True),
        unsure=unsure(fit),
        outliers=outlier_grid(fit),
        reach=position_uncertainty_table(fit),
        reach_of="identification" if fit.validation is None else "validation",
        counted=f"{fit.uncertainty.coverage_sentence}{fit.identification_uncertainty.remark()}",
        sources=sources(fit),
        versions=versions(),
        viewer=viewer,
    )


def printed_page(
    template: str, charts: Charts, command: str, created: datetime | None = None, frame: str = "", **content: object
) -> ViewerPage:
    """Return a page for the screen and for paper from a template, its plots, and further variables.

    `created` is printed (default: now); `frame` is the viewer's page, shown in a frame.
    """
    when = created if created is not None else datetime.now(UTC)
    about = {"program": PROGRAM, "command": command, "created": when.strftime("%Y-%m-%d %H:%M UTC")}
    return ViewerPage(
        page_environment().get_template(template).render(**about, **chart_parts(charts, frame), **content)
    )


def _charts(fit: Fit, scene: ViewerScene | None) -> Charts:
    plots = places(
        parameters=(parameters(fit), dials(fit)),
        budget=(waterfall(fit), joint_shares(fit)),
        worth=file_worth_chart(fit),
    )
    if scene is None or not scene.n_rows:
        return Charts(plots)
    return Charts(
        plots
        | places(
            errors=(
                *error_charts(fit, scene),
                conditions(fit, scene),
                corrections(fit, scene.joints),
            ),
            coverage=coverage(scene, fit),
        ),
        page_rows(scene),
    )


def _space(scene: ViewerScene | None, part: str) -> list[float] | None:
    """RMS distance [mm] before and after of points read in another unit by one instrument; else None."""
    alike = [] if scene is None else [other for other in scene.others if other["part"] == part]
    return mean_distances(scene, alike[0]) if scene is not None and len(alike) == 1 else None


def page_environment() -> Environment:
    """Return the environment of printed pages: it escapes all inserted text and formats numbers."""
    environment = templates(trim_blocks=True, lstrip_blocks=True)
    formats = {"mm": millimetres, "number": number, "significant": significant, "sentence": sentence, "cell": cell}
    environment.filters |= formats | {"powers": powers, "unbroken": unbroken, "labelled": labelled}
    return environment


def frame_name(robot: Robot) -> str:
    """Return the name of the frame of measured coordinates: a link's name only if it is that link's frame."""
    base = robot.description.base
    is_link = base.pose == "known" and not np.any([base.xyz, base.rpy])
    return base.frame if is_link else "the measurement frame"


def sources(fit: Fit) -> list[dict[str, str]]:
    """Return the files behind the fit, with their hashes; the URDF's hash is of the content as read."""
    result = [_source("Robot description", fit.nominal.path)]
    if fit.nominal.urdf.path != fit.nominal.path:
        digest = hashlib.sha256(fit.nominal.urdf.source).hexdigest()
        result.append({"role": "URDF", "path": fit.nominal.urdf.path, "digest": digest})
    result.append(_source("Measurements to identify with", fit.identification.data.path))
    if fit.validation is not None:
        same = fit.validation.data.path == fit.identification.data.path
        role = "Measurements to validate with" + (", held out of the same file" if same else "")
        result.append(_source(role, fit.validation.data.path))
    return result


def _source(role: str, path: str) -> dict[str, str]:
    try:
        return {"role": role, "path": path, "digest": hashlib.sha256(Path(path).read_bytes()).hexdigest()}
    except OSError:
        return {"role": role, "path": path or "not from a file", "digest": "no file to hash"}


def versions() -> list[tuple[str, str]]:
    """Return the programs behind the fit, and their versions."""
    programs = [("Python", platform.python_version())]
    for package in _PACKAGES:
        try:
            programs.append((package, version(package)))
        except PackageNotFoundError:
            programs.append((package, "unknown"))
    return [*programs, ("system", f"{platform.system()} {platform.machine()}")]


def command_line() -> str:
    """Return the command line of this process if it is `calib` or `medrue`, else an empty text."""
    name = Path(sys.argv[0]).name if sys.argv else ""
    if name == "__main__.py":
        return shlex.join(["python", "-m", Path(sys.argv[0]).parent.name, *sys.argv[1:]])
    return shlex.join([name, *sys.argv[1:]]) if name in ("calib", "medrue") else ""


def millimetres(value: float) -> str:
    """Format a length in mm with three significant digits; a dash for unknown."""
    size = abs(value)
    return number(value, 4 if size < 0.1 else 3 if size < 1 else 2 if size < 10 else 1)


def unbroken(text: str) -> Markup:
    """Return text as HTML whose options, such as --html, and percentages do not break; copies of options work."""
    whole = re.sub(r"(?<=\d) %", "\u00a0%", str(escape(text)))
    return Markup(re.sub(r"(?<![\w-])--\w[\w-]*", r'<span class="option">\g<0></span>', whole))


def labelled(line: str) -> Markup:
    """Return a line as HTML, with a short text before its colon in bold type."""
    label, colon, rest = line.partition(": ")
    if not rest or len(label) > _LONGEST_LABEL:
        return unbroken(line)
    return Markup("<strong>{}</strong> {}").format(label + colon.strip(), unbroken(rest))


def powers(text: str) -> str:
    """Return text whose numbers, such as 7.1e-05, do not break after the sign of their exponent."""
    return re.sub(r"(?<=\de)-(?=\d)", "−", text)


def decimals_of(std: float) -> int:
    """Return the number of decimals for two digits of a value's standard deviation; four without."""
    if not (np.isfinite(std) and std > 0):
        return _DECIMALS
    return int(np.clip(1 - np.floor(np.log10(std)), 0, _MOST_DECIMALS))


def significant(value: float, std: float) -> str:
    """Format a number to two digits of its standard deviation, or with as few decimals as it needs without."""
    if np.isfinite(std) and std > 0:
        return number(value, decimals_of(std))
    return number(value, next((n for n in range(_DECIMALS) if round(value, n) == round(value, _DECIMALS)), _DECIMALS))


def cell(content: str | GridNumber) -> str:
    """Format the cell of a table."""
    if isinstance(content, str):
        return content
    if content.page_decimals is not None:
        return number(content.value, content.page_decimals)
    return millimetres(content.value) if content.std is None else significant(content.value, content.std)


def number(value: float, decimals: int = _DECIMALS) -> str:
    """Format a number; a dash for unknown, and no sign before a zero."""
    if not np.isfinite(value):
        return "–"
    text = f"{value:.{decimals}f}"
    return text.replace("-", "−" if float(text) else "")
