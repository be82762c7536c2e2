"""`calib simulate`: measurements from a known truth."""

from __future__ import annotations

from dataclasses import replace

import click
import numpy as np

from calib.core.base.errors import InputError
from calib.core.base.files import write_folder
from calib.core.base.registry import load_entry
from calib.core.base.words import count_noun
from calib.core.commands.common import (
    SIGMA_HELP,
    Output,
    folder_of_values,
    load_robot,
    shared_options,
    sigma_in_metres,
    with_values,
)
from calib.core.data.measurement_files import format_measurements
from calib.core.data.plan_files import read_plan
from calib.core.instruments.pixel import Pixel
from calib.core.robots.configurations import near_singularities
from calib.core.robots.robot import Robot
from calib.core.rows.simulate import simulate, unstated_noise
from calib.shared.pose_check import free_poses


@click.command("simulate")
@click.argument("robot")
@click.argument("joints")
@click.option(
    "--parameters", metavar="FILE", help="True parameter values (CSV parameter,value,unit); nominal if not given."
)
@click.option("--sigma-mm", type=float, help=f"{SIGMA_HELP}. 0: no instrument has noise.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of the noise.")
@click.option(
    "--photographs",
    metavar="DIR",
    help="Write simulated photographs of the camera's board, one for each pose, instead of its pixels.",
)
@click.option("-o", "--out", required=True, metavar="FILE", help="CSV file to write.")
@shared_options()
def command(
    robot: str,
    joints: str,
    parameters: str | None,
    sigma_mm: float | None,
    seed: int,
    photographs: str | None,
    out: str,
    output: Output,
) -> None:
    """Simulate measurements of ROBOT at the poses in JOINTS (CSV).

    Every instrument reads at every pose, or those that a column `instrument` names. An instrument that touches has a
    column of its name, which says what is touched; the joint values are changed so that the robot touches it.
    """
    model = with_values(load_robot(robot, output), parameters, None)
    sigma = None if sigma_mm is None else sigma_in_metres(sigma_mm, zero=True)
    camera = None if photographs is None else _camera(model)
    _require_noise(model, sigma, camera)
    poses = read_plan(joints, model)
    poses, notes = free_poses(model, poses)
    output.check(out, folders=(photographs,))
    remarks = near_singularities(model, model.assemble(poses.joints, labels=poses.labels), poses.labels)
    measured = simulate(model, poses, sigma, np.random.default_rng(seed))
    truth = parameters or folder_of_values(robot, None, None) or "nominal parameters"
    simulated, noise = measured.comments
    comments: tuple[str, ...] = (f"{simulated}; truth: {truth}", f"{noise}, seed {seed}")
    moved = np.flatnonzero(np.any(measured.joints != poses.joints, axis=1))
    if len(moved):
        comments += (f"joint values of {count_noun(len(moved), 'visit')} are changed so that the robot is in contact",)
    if photographs and camera:
        with output.working("rendering photographs"):
            photographs_of = load_entry("calib.methods", "photographs")
            images = photographs_of(model, camera, measured, np.random.default_rng(seed))
        others = {name: readings for name, readings in measured.readings.items() if name != camera.name}
        measured = replace(measured, readings=others)
        write_folder(photographs, images, force=output.force)
    output.write(out, format_measurements(model, measured, comments))
    output.remarks((*notes, *remarks))
    output.say(f"{count_noun(len(poses), 'simulated pose')} written to {out}, seed {seed}")
    if photographs:
        output.say(f"{count_noun(len(poses), 'simulated photograph')} written to {photographs}")
    if len(moved):
        output.say(f"Joint values of {count_noun(len(moved), 'visit')} were changed so that the robot is in contact")


def _camera(robot: Robot) -> Pixel:
    """The one camera of a robot that looks at a board."""
    cameras = [each for each in robot.instruments if isinstance(each, Pixel) and each.board and each.image]
    if len(cameras) != 1:
        raise InputError(
            f"{robot.path}: has {count_noun(len(cameras), 'camera')} that can photograph; --photographs needs one"
            " camera with 'board' and 'image'"
        )
    return cameras[0]


def _require_noise(robot: Robot, sigma: float | None, photographing: Pixel | None) -> None:
    """Raise `InputError` if the noise of an instrument is not stated; photographs have their own noise."""
    exempt = {photographing.name} if photographing else set()
    unstated = [] if sigma == 0 else [name for name in unstated_noise(robot, sigma) if name not in exempt]
    if not unstated:
        return
    named = ", ".join(f"'{name}'" for name in unstated)
    remedy = "state it there, or give --sigma-mm"
    if unstated_noise(robot, 1.0):
        remedy = "state it there (--sigma-mm is for positions only), or give --sigma-mm 0 for no noise at all"
    raise InputError(f"{robot.path}: states no noise (sigma) of {named}; {remedy}")
