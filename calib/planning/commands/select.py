"""`calib select`: the choice of poses to measure."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import partial

import click
import numpy as np

from calib.core.base.errors import ComputationError, InputError, NotIdentifiableError, nearest
from calib.core.base.files import write_folder
from calib.core.base.units import from_unit, quantity_text
from calib.core.commands.common import (
    SIGMA_HELP,
    Output,
    folder_of_values,
    jobs_option,
    load_robot,
    shared_options,
    sigma_in_metres,
    values_options,
    with_values,
)
from calib.core.commands.next_steps import options_as_typed
from calib.core.data.measurement_files import read_poses
from calib.core.data.measurements import Measurements, Poses
from calib.core.data.plan_files import plan_of_table, read_pose_files
from calib.core.data.robot_tables import read_robot_table
from calib.pictures import figures
from calib.planning.instrument_choice import ALL, EACH
from calib.planning.pose_sampling import little_seen
from calib.planning.selection import select
from calib.planning.selection_problem import CHOICES, TASK
from calib.planning.selection_result import Selection
from calib.planning.selection_text import advice_after_select, format_poses, text_report, to_dict
from calib.shared.pose_files import different_poses, place_by_files

_TRIED = (3, 4, 5, 6, 8, 10, 12, 15, 20, 25, 30, 40, 50, 65, 80, 100)
"""Numbers of poses to try for a goal."""


@click.command("select")
@click.argument("robot")
@click.argument("candidates")
@click.option(
    "-n",
    "--count",
    help="How many poses to choose; or how many with each instrument, such as tracker=12,sockets=18.",
)
@click.option(
    "--goal-mm",
    type=float,
    help="In place of --count: the fewest poses whose predicted RMS position error over --task is below this [mm], with"
    " --index task.",
)
@click.option(
    "--instruments",
    metavar="all|each|LIST",
    default=ALL,
    show_default=True,
    help="Instruments that read at a chosen pose. all: every one; each: those that help most; LIST: one of a list, such"
    " as tracker,sockets+ballbar (those joined by + read together).",
)
@click.option(
    "--index",
    type=click.Choice(CHOICES, case_sensitive=False),
    default="O1",
    show_default=True,
    help="What to optimise: an observability index, or 'task', the predicted position error.",
)
@click.option("--measured", metavar="FILE", help="Poses already measured (CSV): choose poses to add to these.")
@click.option("--task", metavar="FILE", help="Poses whose accuracy counts (CSV); the candidates if not given.")
@click.option(
    "--exclude",
    metavar="POSES",
    help="Candidates not to choose: names from the 'pose' column (or row numbers), such as 3,17,20-25.",
)
@click.option(
    "--min-distance-mm", type=float, default=0.0, help="Least distance between the targets of two poses [mm]."
)
@click.option(
    "--start",
    type=click.Choice(["uniform", "random"]),
    default="uniform",
    show_default=True,
    help="How the exchange starts.",
)
@click.option(
    "--starts", type=int, default=1, show_default=True, help="Number of starts; all but the first are random."
)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of everything random.")
@jobs_option("starts")
@click.option(
    "--skip-unreachable", is_flag=True, help="List candidates that cannot be assembled, and go on without them."
)
@click.option("--sigma-mm", type=float, help=f"{SIGMA_HELP}.")
@values_options
@click.option("--plots", metavar="DIR", help="Folder for a figure of the index over the exchanges.")
@click.option(
    "-o", "--out", required=True, metavar="FILE", help="CSV file to write: the chosen poses in order of measurement."
)
@shared_options(json_output=True)
def command(
    robot: str,
    candidates: str,
    count: str | None,
    goal_mm: float | None,
    instruments: str,
    index: str,
    measured: str | None,
    task: str | None,
    exclude: str | None,
    min_distance_mm: float,
    start: str,
    starts: int,
    seed: int,
    jobs: int,
    skip_unreachable: bool,
    sigma_mm: float | None,
    parameters: str | None,
    result: str | None,
    plots: str | None,
    out: str,
    output: Output,
) -> None:
    """Choose the poses from CANDIDATES (CSV) whose measurement determines the parameters of ROBOT best.

    With several instruments and --instruments, it also chooses which of them reads at which pose: the written file has
    a column `instrument`. A candidate for a touch must name what is touched, in the column of that instrument.
    """
    if (count is None) == (goal_mm is None):
        raise InputError("give one of --count and --goal-mm: the number of poses, or the error to reach")
    sigma = None if sigma_mm is None else sigma_in_metres(sigma_mm)
    model = with_values(load_robot(robot, output), parameters, result)
    result = folder_of_values(robot, parameters, result)
    table = read_robot_table(candidates, model)
    poses = read_pose_files((candidates,), model, table)
    done = None if measured is None else read_pose_files((measured,), model)
    if parameters is None and result is None:
        model = place_by_files(model, done, poses)
    poses = different_poses(plan_of_table(table, model) if isinstance(poses, Measurements) else poses)
    output.check(out, folders=(plots,))
    if (few := little_seen(model, poses)) is not None:
        output.note(f"note: {few}")
    with output.working(f"choosing from {len(poses)} poses") as progress:
        choose = partial(
            select,
            model,
            poses,
            instruments=instruments if instruments in (ALL, EACH) else instruments.split(","),
            measured=done,
            task=None if task is None else read_poses(task, model),
            exclude=() if exclude is None else _candidate_numbers(exclude, poses),
            minimum_distance=from_unit(min_distance_mm, "mm"),
            random_start=start == "random",
            starts=starts,
            seed=seed,
            skip_unreachable=skip_unreachable,
            sigma=sigma,
            executor=jobs,
            progress=progress,
        )
        if goal_mm is None:
            selection = choose(_counts(str(count)), index)
        else:
            selection = _reaching(choose, from_unit(goal_mm, "mm"), len(poses))
    output.write(out, format_poses(model, selection, poses, table))
    if plots is not None:
        write_folder(plots, figures(selection), force=output.force)
    output.say(text_report(selection, poses))
    output.remarks(selection.check.notes)
    output.say(f"Written to {out}" + (f", figure to {plots}" if plots is not None else ""))
    output.say(advice_after_select(robot, out, options_as_typed()))
    output.json({"robot": model.path} | to_dict(selection, poses))


def _reaching(choose: Callable[[int, str], Selection], goal: float, most: int) -> Selection:
    """The choice with the fewest poses, of the numbers in `_TRIED`, whose predicted error is below the goal [m]."""
    left = np.inf
    for count in (count for count in _TRIED if count <= most):
        with suppress(NotIdentifiableError):
            selection = choose(count, TASK)
            left = selection.after[TASK]
            if left <= goal:
                return selection
    raise ComputationError(
        f"no choice of up to {min(most, _TRIED[-1])} candidates brings the predicted error below"
        f" {quantity_text(goal, 'mm', 'g')} (the best: {quantity_text(left, 'mm')}); give more candidates, or less"
        " noise"
    )


def _counts(text: str) -> int | dict[str, int]:
    parts = [part.strip().rpartition("=") for part in text.split(",")]
    if not all(number.strip().lstrip("-").isdecimal() and bool(name) == bool(sign) for name, sign, number in parts):
        raise InputError(f"--count {text}: must be a number, or one for each instrument, such as tracker=12,sockets=18")
    if not parts[0][0] and len(parts) == 1:
        return int(parts[0][2])
    counts = {name.strip(): int(number) for name, _, number in parts}
    if "" in counts or len(counts) < len(parts):
        raise InputError(f"--count {text}: name each instrument, or each group of them, once")
    return counts


def _candidate_numbers(text: str, poses: Poses) -> list[int]:
    number_of = {name: k for k, name in enumerate(poses.names)}
    excluded: list[int] = []
    for item in (part.strip() for part in text.split(",")):
        first, _, last = item.partition("-")
        if item in number_of:
            excluded.append(number_of[item])
        elif first.isdigit() and last.isdigit() and int(first) <= int(last):
            names = [str(k) for k in range(int(first), int(last) + 1)]
            missing = [name for name in names if name not in number_of]
            if missing:
                raise InputError(f"--exclude {item}: {poses.path} has no pose '{missing[0]}'")
            excluded += [number_of[name] for name in names]
        else:
            raise InputError(f"--exclude: {poses.path} has no pose '{item}'{nearest(item, number_of)}")
    return excluded
