"""`calib predict`: where the targets are at given joint values."""

from __future__ import annotations

import click
import numpy as np

from calib.core.base.units import millimetres, quantity_text
from calib.core.base.words import count_noun, listing
from calib.core.commands.common import (
    Output,
    failure_lines,
    folder_of_values,
    load_robot,
    shared_options,
    values_options,
    with_values,
)
from calib.core.data.measurement_columns import APPROACH
from calib.core.data.measurement_files import format_positions, read_poses
from calib.core.data.measurements import Poses
from calib.core.judging.claim import Claim
from calib.core.results.result_reading import load_result
from calib.core.robots.configurations import near_singularities
from calib.core.robots.robot import Robot
from calib.core.robots.terms.term import Condition

_FURTHER = 1.05
"""A message compares the errors with those at poses like the measured ones if they are this many times as large."""


@click.command("predict")
@click.argument("robot")
@click.argument("joints")
@values_options
@click.option("-o", "--out", required=True, metavar="FILE", help="CSV file to write.")
@shared_options(json_output=True)
def command(robot: str, joints: str, parameters: str | None, result: str | None, out: str, output: Output) -> None:
    """Predict target positions of ROBOT at the poses in JOINTS (CSV), loops closed.

    With --result, the output also has the standard deviation of each predicted coordinate, and says how far off the
    real tool is expected to be there.
    """
    nominal = load_robot(robot, output)
    model = with_values(nominal, parameters, result)
    result = folder_of_values(robot, parameters, result)
    poses = read_poses(joints, model)
    output.check(out)
    configurations = model.assemble(poses.joints, labels=poses.labels, context=poses.conditions)
    remarks = near_singularities(model, configurations, poses.labels)
    source = parameters or result or "nominal values"
    comment = (f"predicted positions of {model.name}, {source}", *failure_lines(output, result, out))
    content: dict[str, object] = {"robot": model.path, "values": source, "n_poses": len(poses), "file": out}
    content["near_singular"] = remarks
    if result:
        calibrated = load_result(result, nominal)
        known = calibrated.reported_uncertainty
        predicted = known.predict(poses.joints, poses.conditions)
        measured = predicted.measured or predicted  # positions are written as the instruments see them
        text = format_positions(known.robot, poses, measured.positions, comment, measured.std)
        summary = predicted.table() | {"worst_pose": poses.names[predicted.worst]}
        content["position_uncertainty"] = summary
        content["claim"] = calibrated.content["verdict"].get("claim")
        known_here = float(np.sqrt(np.mean(predicted.reported_distance**2)))
        content["expected"], expected = _expected_error(calibrated.verdict.claim, known_here)
        content["beyond_curves"] = beyond = calibrated.remarks_beyond_curves(poses)
        remarks = remarks + beyond + _unknown_conditions(model, poses)
    else:
        text = format_positions(model, poses, model.positions(poses.joints, poses.conditions), comment)
    output.write(out, text)
    output.remarks(remarks)
    output.say(f"{count_noun(len(poses), 'pose')} written to {out}")
    if result:
        if expected:
            output.say(expected)
        output.say(
            f"Positions are known to {summary['mean']:.4f} mm on average, {summary['max']:.4f} mm at worst"
            f" (pose {summary['worst_pose']}), {known.uncertainty.coverage_sentence}{predicted.remark()}"
        )
    output.json(content)


def _unknown_conditions(robot: Robot, poses: Poses) -> list[str]:
    """Return remarks on conditions that joint terms depend on, and that the poses do not state.

    A load is none of them: terms depend on it where none is carried, too.
    """
    remarks, needed = [], {condition for term in robot.terms for condition in term.depends_on}
    sides = [f"{APPROACH}{term.joint}" for term in robot.terms if Condition.APPROACH in term.depends_on]
    if sides and poses.approach is None:
        remarks.append(
            f"{poses.path}: states no directions of approach; positions are in the middle of the backlash, and their"
            f" uncertainty counts it. If the directions are known, add {listing(sides)} (+1 or -1)"
        )
    columns = sorted(condition.column for condition in needed - {Condition.LOAD} if condition.column)
    absent = [column for column in columns if column not in poses.context]
    if absent:
        taken = [f"{column} {'20 degC' if column == Condition.TEMPERATURE.column else '0'}" for column in absent]
        remarks.append(f"{poses.path}: has no column {listing(absent)}; positions are those at {listing(taken)}")
    return remarks


def _expected_error(claim: Claim | None, known: float) -> tuple[dict[str, float] | None, str]:
    """Expected error of the tool where positions are known to `known` [m], as data and in words; None if unknown."""
    if claim is None or not np.isfinite(claim.at_measured_poses.limit95 + claim.rms):
        return None, ""
    here = claim.error_at(known)
    words = f"The real tool is within {quantity_text(here.limit95, 'mm')} of these positions, 95 % of the time"
    if here.times < _FURTHER:
        words += f", {claim.region}"
    else:
        words += f". This is {here.times:.2g} times as far as {claim.region}"
    return {"rms": millimetres(here.rms), "limit95": millimetres(here.limit95), "times": here.times}, words
