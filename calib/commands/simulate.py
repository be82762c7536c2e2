"""`calib simulate`: measurements from a known truth."""

from __future__ import annotations

import click
import numpy as np

from calib.base.errors import InputError
from calib.base.words import counted
from calib.commands.common import (
    SIGMA_HELP,
    Output,
    folder_of_values,
    loaded,
    shared_options,
    sigma_in_metres,
    with_values,
)
from calib.data.measurement_files import format_measurements
from calib.data.plan_files import read_plan
from calib.robots.configurations import near_singularities
from calib.robots.robot import Robot
from calib.rows.simulate import simulate, unstated_noise


@click.command("simulate")
@click.argument("robot")
@click.argument("joints")
@click.option(
    "--parameters", metavar="FILE", help="True parameter values (CSV parameter,value,unit); nominal if not given."
)
@click.option("--sigma-mm", type=float, help=f"{SIGMA_HELP}; 0: no noise of anything.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of the noise.")
@click.option("--out", required=True, metavar="FILE", help="CSV file to write.")
@shared_options()
def command(
    robot: str, joints: str, parameters: str | None, sigma_mm: float | None, seed: int, out: str, output: Output
) -> None:
    """Simulate measurements of ROBOT at the poses in JOINTS (CSV).

    Every instrument reads at every pose, or those that a column `instrument` names. An instrument that touches has a
    column of its name, which says what is touched; the joint values are changed so that the robot touches it.
    """
    model = with_values(loaded(robot, output), parameters, None)
    sigma = None if sigma_mm is None else sigma_in_metres(sigma_mm, zero=True)
    _require_noise(model, sigma)
    poses = read_plan(joints, model)
    output.check(out)
    remarks = near_singularities(model, model.assemble(poses.joints, labels=poses.labels), poses.labels)
    measured = simulate(model, poses, sigma, np.random.default_rng(seed))
    truth = parameters or folder_of_values(robot, None, None) or "nominal parameters"
    comments: tuple[str, ...] = (
        f"simulated measurements of {model.name}; truth: {truth}",
        f"{_noise_in_words(model, sigma_mm)}, seed {seed}",
    )
    moved = np.flatnonzero(np.any(measured.joints != poses.joints, axis=1))
    if len(moved):
        comments += (f"joint values of {counted(len(moved), 'visit')} are changed so that the robot touches",)
    output.write(out, format_measurements(model, measured, comments))
    output.remarks(remarks)
    output.say(f"{counted(len(poses), 'simulated pose')} written to {out}, seed {seed}")
    if len(moved):
        output.say(f"Joint values of {counted(len(moved), 'visit')} were changed so that the robot touches")


def _noise_in_words(robot: Robot, sigma_mm: float | None) -> str:
    if sigma_mm is None:
        return "noise as the description states it"
    said = f"normal noise, sigma {sigma_mm:g} mm per axis"
    if sigma_mm == 0 or all(part.is_position for one in robot.instruments for part in one.parts):
        return said
    return f"{said} of positions, else as the description states it"


def _require_noise(robot: Robot, sigma: float | None) -> None:
    """Raise `InputError` if the noise of an instrument is not stated."""
    unstated = [] if sigma == 0 else unstated_noise(robot, sigma)
    if not unstated:
        return
    named = ", ".join(f"'{name}'" for name in unstated)
    remedy = "state it there, or give --sigma-mm"
    if unstated_noise(robot, 1.0):
        remedy = "state it there, as --sigma-mm speaks of positions only, or give --sigma-mm 0 for no noise of anything"
    raise InputError(f"{robot.path}: states no noise (sigma) of {named}; {remedy}")
