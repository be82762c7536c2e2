"""`calib predict`: where the targets are at given joint values."""

from __future__ import annotations

import click
import numpy as np

from calib.commands.common import Output, shared_options, with_values
from calib.errors import UnreachablePoseError
from calib.files import check_file, write_file
from calib.measurements import format_measurements, read_poses
from calib.robot import describe_open, load


@click.command("predict")
@click.argument("robot")
@click.argument("joints")
@click.option("--parameters", metavar="FILE", help="Parameter values (CSV parameter,value,unit); nominal if not given.")
@click.option("--result", metavar="DIR", help="Use the calibrated values of this result folder.")
@click.option("--out", required=True, metavar="FILE", help="CSV file to write.")
@shared_options()
def command(robot: str, joints: str, parameters: str | None, result: str | None, out: str, output: Output) -> None:
    """Predict target positions of ROBOT at the poses in JOINTS (CSV), loops closed."""
    check_file(out)
    model = with_values(load(robot), parameters, result)
    poses = read_poses(joints, model)
    closed = model.close(poses.joints)
    if not np.all(closed.ok):
        raise UnreachablePoseError(describe_open(model, poses.joints, closed, poses.labels))
    positions = model.positions(poses.joints)
    source = parameters or result or "nominal values"
    write_file(out, format_measurements(model, poses, positions, (f"predicted positions of {model.name}, {source}",)))
    output.say(f"{len(poses)} poses written to {out}")
