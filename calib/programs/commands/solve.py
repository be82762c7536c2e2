"""`calib solve`: joint commands that reach goals."""

from __future__ import annotations

import click
import numpy as np

from calib.core.base.arrays import IntArray
from calib.core.base.contributions import names_of
from calib.core.base.units import in_unit, millimetres, quantity_text
from calib.core.commands.common import (
    Output,
    failure_lines,
    folder_of_values,
    load_robot,
    shared_options,
    values_options,
    with_values,
)
from calib.core.data.measurement_columns import approach_columns, condition_columns, joint_columns
from calib.core.data.table_writing import format_table
from calib.core.results.result_reading import load_result
from calib.core.robots.configurations import near_singularities
from calib.core.robots.robot import Robot
from calib.programs.commands.report import (
    expected_error_sentence,
    frame_sentences,
    frame_words,
    no_correction_sentence,
    rows_of,
    summary,
)
from calib.programs.reaching.goals import Goals, read_goals
from calib.programs.reaching.inverse import Solution, solve


@click.command("solve")
@click.argument("robot")
@click.argument("goals_file", metavar="GOALS")
@values_options
@click.option("--skip-unreachable", is_flag=True, help="List goals that are out of reach, and write the others.")
@click.option(
    "-o", "--out", required=True, metavar="FILE", help="CSV file to write: joint values and positions reached."
)
@shared_options(json_output=True)
def command(
    robot: str,
    goals_file: str,
    parameters: str | None,
    result: str | None,
    skip_unreachable: bool,
    out: str,
    output: Output,
) -> None:
    """Find joint values that bring a target of ROBOT to the goals in GOALS (CSV), through the closed loops.

    GOALS has the columns TARGET_x, TARGET_y, TARGET_z (such as 'tool_x [mm]'), in the measurement frame. Add
    TARGET_rx, _ry, _rz (such as 'tool_rx [deg]'; roll, pitch, yaw about fixed axes, as URDF's rpy) to ask for the
    orientation of the target's link too, or TARGET_ax, _ay, _az (no unit) to ask for the direction of its z axis.
    Leave empty the cells of a coordinate that the robot cannot choose, such as z if it moves in the plane of x and y.

    A column 'pose' names the rows. Columns 'load', 'temperature', 'time', 'setup', 'approach_JOINT' and those of
    gravity have the conditions at each goal, on which joint terms may depend. If inclinometers measure joints, each
    row also has the columns of these joints or of their sensors. Joint limits and the home's assembly mode are kept;
    free coordinates stay near home.

    With a result, the written file says how far the real robot is expected to be off at each goal, in the measurement
    frame. If the verdict of the calibration finds nothing to correct, the nominal robot is used, with base and targets
    where it agrees best with the calibrated one.
    """
    nominal, folder = load_robot(robot, output), folder_of_values(robot, parameters, result)
    model = with_values(nominal, parameters, result)
    goals = read_goals(goals_file, model)
    output.check(out)
    with output.working(f"solving {len(goals)} goals"):
        solution = solve(load_result(folder, nominal).known_robot if folder else model, goals)
    misses, expected = solution.unreached_goals(), solution.expected
    reached = np.flatnonzero(solution.ok)
    if not skip_unreachable or not np.any(solution.ok):
        solution.require_all()
    for miss in misses:
        output.note(f"{miss}; skipped")
    source = parameters or folder or "nominal values"
    comment = f"joint values of {model.name} that reach {goals_file} ({goals.asks_for}), {source}"
    if solution.expected.nothing_to_correct:
        comment += f"; those of the nominal robot: {no_correction_sentence(source)}"
    if folder:
        comment += f"; {frame_words(solution.expected)}"
    comments = (comment, *failure_lines(output, folder, out))
    output.write(out, _table(model, goals, solution, comments))
    labels = [solution.labels[k] for k in reached]
    remarks = near_singularities(model, model.assemble(solution.q[reached], labels=labels), labels)
    output.remarks(remarks)
    states = {
        "reached": solution.ok.tolist(),
        "miss_mm": millimetres(solution.miss_position).tolist(),
        "miss_deg": in_unit(solution.miss_angle, "deg").tolist(),
    }
    output.json(
        {
            "robot": model.path,
            "asked_for": goals.asks_for,
            **({"frame": expected.frame, "contains": names_of(expected.contains)} if folder else {}),
            "nothing_to_correct": solution.expected.nothing_to_correct,
            "targets": rows_of(model, goals.names, solution.q, solution.ok, states, expected.figures()),
            "near_singular": remarks,
        }
    )
    lines = [
        f"{len(reached)} of {len(goals)} goals reached ({goals.asks_for}), largest miss"
        f" {quantity_text(solution.miss_position[reached].max(), 'um', '.1e')}; written to {out}"
    ]
    if folder:
        lines += _expected_error_lines(solution, reached, source)
    output.say("\n".join(lines))


def _expected_error_lines(solution: Solution, reached: IntArray, source: str) -> list[str]:
    """Return sentences on the expected error of the real robot at the reached goals."""
    expected, subjects = solution.expected, {"expected": "The real robot", "expected_angle": "Its orientation"}
    of_nominal = f"The joint values are those of the nominal robot: {no_correction_sentence(source)}"
    lines = [of_nominal] if expected.nothing_to_correct else []
    lines += [
        expected_error_sentence(subjects[name], summary(values[reached]), unit)
        for (name, unit), values in expected.figures().items()
        if name in subjects
    ]
    return [*lines, frame_sentences(expected)]


def _table(robot: Robot, goals: Goals, solution: Solution, comments: tuple[str, ...]) -> str:
    reached = np.flatnonzero(solution.ok)
    reached_goals = goals.subset(reached)
    columns: dict[str, list[object]] = {"pose": list(reached_goals.names)}
    for name, values in joint_columns(robot, solution.q[reached]).items():
        columns[name] = list(values)
    for axis, values in zip("xyz", millimetres(solution.positions[reached].T), strict=True):
        columns[f"{goals.target}_{axis} [mm]"] = list(values)
    columns |= condition_columns(
        robot, len(reached_goals), reached_goals.setups, reached_goals.context
    ) | approach_columns(robot, reached_goals.approach)
    for (name, unit), values in solution.expected.figures().items():
        columns[f"{name} [{unit}]"] = list(values[reached])
    return format_table(list(columns.items()), comments)
