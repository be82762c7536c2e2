"""`calib study`: many calibrations, and the reliability of their statistics."""

from __future__ import annotations

import os
from typing import Literal

import click

from calib.core.commands.common import (
    SIGMA_HELP,
    Output,
    jobs_option,
    load_robot,
    loss_option,
    shared_options,
    sigma_in_metres,
)
from calib.core.data.measurement_files import read_measurements, read_poses
from calib.core.data.parameter_files import read_parameters
from calib.core.data.plan_files import read_pose_files
from calib.core.results.result_reading import load
from calib.core.robots.robot import Robot
from calib.studies.study import study


@click.command("study")
@click.argument("robot")
@click.argument("poses", nargs=-1, required=True)
@click.option("--draws", type=click.IntRange(min=2), default=1000, show_default=True, help="How many calibrations.")
@click.option(
    "--truth",
    metavar="priors|FILE|DIR",
    help="The true robot. priors: a new one for each draw, from the priors; or parameter values (CSV"
    " parameter,value,unit), a result folder, or a description; ROBOT if not given.",
)
@click.option(
    "--resample",
    is_flag=True,
    help="Simulate nothing: draw poses of the measurements POSES with replacement, and calibrate (bootstrap).",
)
@click.option("--sigma-mm", type=float, help=f"{SIGMA_HELP}.")
@loss_option
@click.option("--elsewhere", metavar="FILE", help="Further poses (CSV) to predict.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of the whole study.")
@jobs_option("the draws", os.cpu_count() or 1)
@click.option("-v", "--verbose", is_flag=True, help="Print all parameters, not only those with the lowest coverage.")
@shared_options(json_output=True)
def command(
    robot: str,
    poses: tuple[str, ...],
    draws: int,
    truth: str | None,
    resample: bool,
    sigma_mm: float | None,
    loss: str,
    elsewhere: str | None,
    seed: int,
    jobs: int,
    verbose: bool,
    output: Output,
) -> None:
    """Calibrate ROBOT many times from simulated measurements at POSES (CSV), and count how often the result is right.

    For each parameter, the output has the mean error, the scatter, the standard deviation that the fits claim, and in
    how many draws the 95 % interval holds the truth. POSES are a plan, joint values or measurements; only the poses
    are used. With --resample, the readings are used too.
    """
    sigma = None if sigma_mm is None else sigma_in_metres(sigma_mm)
    model = load_robot(robot, output)
    measured = read_measurements(poses, model) if resample else read_pose_files(poses, model)
    with output.working("calibrating") as progress:
        studied = study(
            model,
            measured,
            draws=draws,
            truth=_truth(truth, model),
            resample=resample,
            sigma=sigma,
            loss=loss,
            elsewhere=None if elsewhere is None else read_poses(elsewhere, model).joints,
            seed=seed,
            executor=jobs,
            progress=progress,
        )
    output.say(studied.report(verbose=verbose))
    output.json(studied.to_dict())


def _truth(text: str | None, robot: Robot) -> Robot | Literal["priors"] | None:
    """The measured robot, in the form of `calib.study`."""
    if text is None:
        return None
    if text == "priors":
        return "priors"
    return robot.with_parameters(read_parameters(text, robot)) if text.endswith(".csv") else load(text)
