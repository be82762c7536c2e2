"""`calib route`: from chosen poses to a robot that visits them."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import click
import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import InputError
from calib.core.base.files import write_folder
from calib.core.base.units import millimetres, quantity_text
from calib.core.base.words import count_noun, listing
from calib.core.commands.common import (
    Output,
    folder_of_values,
    load_robot,
    shared_options,
    values_options,
    with_values,
)
from calib.core.data.measurement_files import read_poses
from calib.core.data.measurements import Poses
from calib.core.data.plan_files import read_plan, read_pose_files
from calib.core.results.result_reading import forced_lines
from calib.core.robots.robot import Robot
from calib.motion.programs import LANGUAGES, THIRD_JOINT, Motion, table_to_fill_in, write_program
from calib.motion.route import Route, plan_route
from calib.shared.pose_files import different_poses, place_by_files

_READINGS = "readings.csv"


@click.command("route")
@click.argument("robot")
@click.argument("poses")
@click.option(
    "--format",
    "languages",
    multiple=True,
    type=click.Choice(tuple(LANGUAGES)),
    help="Language of the program; may be repeated. csv if not given.",
)
@click.option("--start", metavar="FILE", help="Where the robot stands first (CSV, one row); home if not given.")
@click.option(
    "--candidates",
    metavar="FILE",
    help="Poses (CSV) that replace those that cannot be reached, the best first.",
)
@click.option("--name", default="calib_route", show_default=True, help="Name of the program.")
@click.option(
    "--speed",
    type=click.FloatRange(1, 100),
    default=20,
    show_default=True,
    metavar="PERCENT",
    help="Speed in percent of the controller's largest speed; for urscript and ros2, in percent of 143 deg/s.",
)
@click.option(
    "--dwell",
    type=click.FloatRange(0),
    default=1.0,
    show_default=True,
    metavar="SECONDS",
    help="Wait at each stop, for the arm to settle.",
)
@click.option(
    "--reading",
    type=click.FloatRange(0),
    default=1.0,
    show_default=True,
    metavar="SECONDS",
    help="How long the output is on while the instrument reads.",
)
@click.option(
    "--output-number",
    type=click.IntRange(min=-1),
    default=1,
    show_default=True,
    help="Digital output that triggers the instrument; -1: none.",
)
@click.option("--third-joint", type=click.Choice(THIRD_JOINT), help="FANUC: what the third joint of the URDF is.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of everything random.")
@values_options
@click.option("-o", "--out", required=True, metavar="DIR", help="Folder to write.")
@shared_options(json_output=True)
def command(
    robot: str,
    poses: str,
    languages: tuple[str, ...],
    start: str | None,
    candidates: str | None,
    name: str,
    speed: float,
    dwell: float,
    reading: float,
    output_number: int,
    third_joint: str | None,
    seed: int,
    parameters: str | None,
    result: str | None,
    out: str,
    output: Output,
) -> None:
    """Plan a way through POSES (CSV) on which ROBOT hits neither itself nor what the description says is around it.

    The order of the poses keeps travel short. Every move is checked along its whole length.
    DIR gets a program, a table to fill in (readings.csv), and the route for `calib view ROBOT --data DIR/route.csv`.
    Run the program slowly at first, with a hand at the stop.
    """
    if not re.fullmatch(r"[A-Za-z]\w{0,30}", name, flags=re.ASCII):
        raise InputError(f"--name {name}: needs a letter, then letters, digits and underscores, 31 in all")
    if ("fanuc" in languages) != (third_joint is not None):
        raise InputError(
            "--third-joint is for --format fanuc, which needs it: j3, or j2+j3 where the robot file counts its third"
            " joint from link 2 (descriptions of ROS-Industrial: j2+j3)"
        )
    model = with_values(load_robot(robot, output), parameters, result)
    visits = _read_visits(poses, model)
    model = place_by_files(model, visits)
    spare = None if candidates is None else _read_visits(candidates, model)
    number = None if output_number < 0 else output_number
    motion = Motion(name, speed / 100, 2.5 * speed / 100, dwell, reading, number, third_joint or THIRD_JOINT[0])
    written = languages or ("csv",)
    files = {language: ("route" if language == "csv" else name) + LANGUAGES[language].suffix for language in written}
    files.setdefault("csv", "route.csv")
    output.check(folders=(out,), names=(*files.values(), _READINGS))
    with output.working(f"finding ways to {count_noun(len(visits), 'pose')}") as progress:
        route = plan_route(model, visits, start=_start(start, model), candidates=spare, seed=seed, progress=progress)
    folder = folder_of_values(robot, parameters, result)
    if folder and forced_lines(folder):
        route = replace(route, remarks=(f"the fit in {folder} failed", *route.remarks))
    content = {file: write_program(route, language, motion).encode() for language, file in files.items()}
    write_folder(out, content | {_READINGS: table_to_fill_in(route).encode()}, force=output.force)
    output.say(_report(route))
    output.say(f"Written to {out}: {', '.join(sorted(content))}, {_READINGS}")
    output.say(f"Next: look at it with `calib view {robot} --data {Path(out, 'route.csv')}`, then run it slowly")
    output.json(_data(route))


def _read_visits(path: str, robot: Robot) -> Poses:
    """Different poses of a file, with what they touch, so that touches are approached along the surface's normal."""
    touches = any(instrument.touches for instrument in robot.instruments)
    return different_poses(read_plan(path, robot) if touches else read_pose_files((path,), robot))


def _start(path: str | None, robot: Robot) -> FloatArray | None:
    """Joint values from a file with one row, (n_actuated,) [m or rad]; None without a file."""
    if path is None:
        return None
    poses = read_poses(path, robot)
    if len(poses) != 1:
        raise InputError(f"{path}: has {count_noun(len(poses), 'row')}; --start needs the one where the robot stands")
    return np.asarray(poses.joints[0])


def _report(route: Route) -> str:
    corners = route.corners()
    around = sum(len(stop.corners) > 0 for stop in route.stops)
    travel = quantity_text(np.sum(np.max(np.abs(np.diff(corners, axis=0)), axis=1)), "deg", ".0f")
    lines = [f"{count_noun(len(route.stops), 'stop')}; {around} reached on a way around obstacles; travel {travel}"]
    nearest = min(route.stops, key=lambda stop: min(stop.clearance, stop.path_clearance))
    least = min(nearest.clearance, nearest.path_clearance)
    if np.isfinite(least):
        lines.append(
            f"Smallest clearance {quantity_text(least, 'mm', '.1f')}, at stop {nearest.name} or on the way there"
        )
    if route.left_out:
        named = listing([f"{name} ({why})" for name, why in route.left_out.items()], shown=8)
        lines.append(f"Left out, {count_noun(len(route.left_out), 'pose')}: {named}")
    if route.replaced:
        lines.append(f"In their place: {listing(route.replaced, shown=8)}")
    lines += [f"Note: {remark}" for remark in route.remarks]
    return "\n".join(lines)


def _data(route: Route) -> dict[str, object]:
    return {
        "robot": route.robot.path,
        "joints": list(route.robot.joint_names),
        "start": route.start.tolist(),
        "stops": [
            {
                "pose": stop.name,
                "joints": stop.joints.tolist(),
                "corners": stop.corners.tolist(),
                "clearance_mm": millimetres(stop.clearance),
                "pair": stop.pair,
                "clearance_on_the_way_mm": millimetres(stop.path_clearance),
            }
            for stop in route.stops
        ],
        "left_out": route.left_out,
        "replaced": list(route.replaced),
        "remarks": list(route.remarks),
    }
