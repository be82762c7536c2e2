"""`calib export`: the robot in the formats of other programs."""

from __future__ import annotations

from dataclasses import asdict
from typing import cast

import click

from calib.core.base.units import quantity_text
from calib.core.commands.common import (
    Output,
    failure_lines,
    folder_of_values,
    load_robot,
    shared_options,
    values_options,
    with_values,
)
from calib.core.results.result_reading import read_content
from calib.core.robots.file_formats import formats
from calib.core.robots.urdf.text import UrdfText
from calib.exporting.file_formats import LANGUAGES
from calib.exporting.formats import JOINT_TABLES, export, format_of
from calib.shared.links import read_links

_WORTH_A_SLIDE = 1e-6  # change of a gap that deserves a remark [m or rad]


@click.command("export")
@click.argument("robot")
@values_options
@click.option(
    "--format",
    "file_format",
    type=click.Choice(tuple(formats())),
    help="By the ending of FILE (.urdf, .xml, .xacro, .c) if not given. urdf: only edited origins change. mjcf:"
    " MuJoCo, Pinocchio, Drake; loops closed. drake: URDF with"
    " ball constraints. toolbox: robot.yaml of toolbox-parallel-robots, and the URDF beside it. dh, mdh:"
    " Denavit-Hartenberg table, standard or modified. ur-kinematics: for Universal Robots' ROS description."
    " joint-offsets: sign and zero of each joint. xacro: joint origins as properties. The files from dh to xacro"
    " state their error. joint-tables: a folder with tables of each joint's error, as CSV, and the URDF"
    " that goes with it. klipper, marlin, duet: lines to paste into the settings of a delta printer. Each file gets"
    " the best robot that it can hold. numpy, c, jax, torch, casadi: the whole model as functions of the commands, in"
    " one file that needs nothing of this program.",
)
@click.option(
    "--free-slide",
    is_flag=True,
    help="mjcf, drake: add a free joint for each direction that a closure leaves free. Tilted links are then exact.",
)
@click.option(
    "--meshes",
    metavar="PREFIX",
    help="urdf, drake, toolbox: put this before relative mesh paths, such as package://my_robot or /home/me/robot, so"
    " that the file may lie anywhere.",
)
@click.option(
    "--provenance",
    is_flag=True,
    help="urdf, toolbox, joint-tables: say in a comment where the numbers come from; numpy, c, jax, torch and casadi"
    " always do.",
)
@click.option("-o", "--out", required=True, metavar="FILE", help="File to write; for joint-tables, the folder.")
@shared_options(
    json_output=True,
    forced="Write the file even if its robot is worse than the nominal one, or lacks joint terms that its values need"
    " (it says so inside). Also replace files that this program did not write, or that this command reads.",
)
def command(
    robot: str,
    parameters: str | None,
    result: str | None,
    file_format: str | None,
    free_slide: bool,
    meshes: str | None,
    provenance: bool,
    out: str,
    output: Output,
) -> None:
    """Write ROBOT (YAML description, URDF or result folder), nominal or calibrated, for other programs."""
    file_format = file_format or format_of(out)
    model = with_values(load_robot(robot, output), parameters, result)
    result = folder_of_values(robot, parameters, result)
    lines = _origin_of_values(parameters, result) if provenance or file_format in LANGUAGES else None
    if failed := failure_lines(output, result, out):
        lines = [*(lines or []), *failed]
    notes: list[str] = []
    relative = _relative_meshes(model.urdf)  # before anything is written, since a broken shape is an error
    output.check(*(() if file_format == JOINT_TABLES else (out,)))
    gaps = export(
        model,
        out,
        file_format,
        free_slide=free_slide,
        meshes=meshes,
        provenance=lines,
        note=notes.append,
        force=output.force,
    )
    output.say(f"{model.name}, {parameters or result or 'nominal values'}: written to {out}")
    for text in notes:
        if formats()[file_format].write:
            output.say(text)
        else:
            output.note(f"note: {text}")
    if file_format != "urdf":
        for gap in gaps:
            output.say(gap.text())
        if file_format != "toolbox" and any(gap.change > _WORTH_A_SLIDE for gap in gaps):
            output.note("note: these gaps strain the simulated links and motors; --free-slide avoids that")
    if relative and not meshes and file_format in ("urdf", "drake", "toolbox"):
        output.note(
            f"note: mesh paths such as '{relative}' start at the folder of the URDF; keep the file beside them, or give"
            " --meshes"
        )
    output.json(
        {
            "robot": model.path,
            "format": file_format,
            "file": out,
            "gaps": [asdict(gap) | {"unit": "rad" if gap.dimension == "angle" else "m"} for gap in gaps],
            "notes": notes,
        }
    )


def _origin_of_values(parameters: str | None, result: str | None) -> list[str]:
    if parameters:
        return [f"values: {parameters}"]
    if not result:
        return []
    content = read_content(result)
    sigma = content.get("sigma")
    noise = "unknown" if sigma is None else quantity_text(cast(float, sigma), "mm", ".4g")
    return [
        f"values: {result}, made by {content.get('program', 'an unknown version')}",
        f"fitted to {content['n_poses']} poses, {content['n_rows']} rows; noise found: {noise}",
    ]


def _relative_meshes(urdf: UrdfText) -> str:
    """The first mesh file with a path relative to the URDF, or ""."""

    shapes = (shape for link in read_links(urdf).values() for shape in (*link.visuals, *link.collisions))
    return next(
        (shape.file for shape in shapes if shape.file and "://" not in shape.file and not shape.file.startswith("/")),
        "",
    )
