"""`calib simulate`: measurements from a known truth."""

from __future__ import annotations

import click
import numpy as np

from calib.commands.common import Output, folder_of_values, loaded, shared_options, sigma_in_metres, with_values
from calib.data.measurement_files import format_measurements, read_poses
from calib.files import check_file, write_file
from calib.linearisation.simulate import simulate
from calib.words import counted


@click.command("simulate")
@click.argument("robot")
@click.argument("joints")
@click.option(
    "--parameters", metavar="FILE", help="True parameter values (CSV parameter,value,unit); nominal if not given."
)
@click.option("--sigma-mm", type=float, required=True, help="Standard deviation of the noise per axis [mm].")
@click.option("--seed", type=click.IntRange(min=0), required=True, help="Seed of the noise.")
@click.option("--out", required=True, metavar="FILE", help="CSV file to write.")
@shared_options()
def command(
    robot: str, joints: str, parameters: str | None, sigma_mm: float, seed: int, out: str, output: Output
) -> None:
    """Simulate measurements of ROBOT at the poses in JOINTS (CSV)."""
    check_file(out)
    model = with_values(loaded(robot, output), parameters, None)
    poses = read_poses(joints, model)
    remarks = model.near_singularities(model.assemble(poses.joints, labels=poses.labels), poses.labels)
    measured = simulate(model, poses, sigma_in_metres(sigma_mm, zero=True), np.random.default_rng(seed))
    truth = parameters or folder_of_values(robot, None, None) or "nominal parameters"
    comments = (
        f"simulated measurements of {model.name}; truth: {truth}",
        f"normal noise, sigma {sigma_mm:g} mm per axis, seed {seed}",
    )
    write_file(out, format_measurements(model, measured, comments))
    output.remarks(remarks)
    output.say(f"{counted(len(poses), 'simulated pose')} written to {out}")
