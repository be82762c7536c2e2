"""`calib sample`: random poses of a robot."""

from __future__ import annotations

import re
from pathlib import Path

import click
import numpy as np

from calib.core.base.errors import InputError, require_known
from calib.core.base.units import Dimension, quantity
from calib.core.base.words import count_noun
from calib.core.commands.common import Output, load_robot, shared_options, values_options, with_values
from calib.core.data.measurement_files import format_measurements, read_poses
from calib.core.data.measurements import measurements
from calib.core.robots.robot import Robot
from calib.planning.pose_sampling import free_sample, little_seen
from calib.shared.pose_check import worth_sentence

_RANGE = re.compile(r"^(?P<name>[^=]+)=(?P<low>[^=]*?)\.\.(?P<high>[^=]*?)(?P<unit>[A-Za-z]*)$")


@click.command("sample")
@click.argument("robot")
@click.option("-n", "--count", type=int, required=True, help="How many poses.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of the joint values.")
@click.option(
    "--within",
    metavar="FILE|RANGE",
    multiple=True,
    help="Stay in the joint ranges that the poses of a file (CSV) span; or in a range of a joint or of a coordinate of"
    " a target, such as joint_2=-90..30deg or tool_z=200..900mm. May be repeated.",
)
@values_options
@click.option("-o", "--out", required=True, metavar="FILE", help="CSV file to write.")
@shared_options()
def command(
    robot: str,
    count: int,
    seed: int,
    within: tuple[str, ...],
    parameters: str | None,
    result: str | None,
    out: str,
    output: Output,
) -> None:
    """Write poses that ROBOT can take, spread at random over its joint limits, loops closed.

    An instrument that touches is in contact at these poses. If only cameras measure, they see their targets there. The
    robot hits neither itself nor the `obstacles` of the description; without shapes and obstacles, nothing is checked.
    Cables are never checked: look at the poses before you send them (calib view ROBOT --data FILE).
    """
    model = with_values(load_robot(robot, output), parameters, result)
    ranges: dict[str, tuple[float, float]] = {}
    for text in within:
        for name, (low, high) in _ranges(text, model).items():
            before = ranges.get(name, (-np.inf, np.inf))
            ranges[name] = max(low, before[0]), min(high, before[1])
    output.check(out)
    with output.working(f"looking for {count} poses"):
        poses, check, unobstructed = free_sample(model, count, np.random.default_rng(seed), ranges)
    comments = (f"poses of {model.name}, sampled with seed {seed}", *(f"within {text}" for text in within))
    output.write(out, format_measurements(model, measurements(poses, poses.planned), comments))
    output.say(f"{count_noun(len(poses), 'pose')} written to {out}, seed {seed}")
    if check.n_blocked:
        output.say(f"Left out: {check.summary()}; {worth_sentence(model, poses, unobstructed)}")
    output.remarks(check.notes)
    if (few := little_seen(model, poses)) is not None:
        output.note(f"note: {few}")


def _ranges(text: str, robot: Robot) -> dict[str, tuple[float, float]]:
    """Ranges of a --within option, by name [SI]."""
    match = None if Path(text).is_file() else _RANGE.match(text)
    if match is None:
        if "=" in text and not Path(text).exists():
            raise InputError(f"--within {text}: is not a range; write it as joint_2=-90..30deg")
        joints = read_poses(text, robot).joints
        spans = zip(joints.min(axis=0).tolist(), joints.max(axis=0).tolist(), strict=True)
        return dict(zip(robot.joint_names, spans, strict=True))
    name, unit = match["name"].strip(), match["unit"]
    dimensions: dict[str, Dimension] = {joint: robot.mechanism.dimensions[joint] for joint in robot.joint_names}
    dimensions |= {f"{target}_{axis}": "length" for target in robot.target_names for axis in "xyz"}
    require_known(name, dimensions, f"--within {text}: no joint or coordinate")
    low, high = (
        quantity(f"{match[key].strip()} {unit}", dimensions[name], f"--within {text}") for key in ("low", "high")
    )
    return {name: (low, high)}
