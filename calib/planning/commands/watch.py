"""`calib watch`: measuring and calibrating at once."""

from __future__ import annotations

import copy
import json
import time

import click
import numpy as np

from calib.core.base.errors import InputError
from calib.core.base.units import quantity
from calib.core.commands.common import SIGMA_HELP, Output, load_robot, shared_options, sigma_in_metres
from calib.core.data.measurement_files import read_measurements
from calib.core.data.measurements import Measurements
from calib.core.data.plan_files import read_plan
from calib.pictures import Live, installed
from calib.planning.progress import LEAST, Progress
from calib.planning.watch import CANDIDATES, GrowingFile, Watch
from calib.shared.pose_files import different_poses

_BEGINNINGS = 8  # earlier states of an existing file, before the present one


@click.command("watch")
@click.argument("robot")
@click.argument("file")
@click.option(
    "--goal",
    required=True,
    metavar="LENGTH",
    help="Stop at this RMS position error over the candidates, with its unit, such as 0.1mm.",
)
@click.option(
    "--candidates",
    metavar="FILE",
    help="Poses (CSV) at which the goal counts, and from which the next one is chosen; if not given,"
    f" {CANDIDATES} over the joint limits.",
)
@click.option("--once", is_flag=True, help="Say what FILE shows now, and end.")
@click.option(
    "--every",
    type=click.FloatRange(min=0.05),
    default=0.5,
    show_default=True,
    metavar="SECONDS",
    help="How often to look whether FILE has grown.",
)
@click.option(
    "--view",
    is_flag=True,
    help="Show it in a browser on this computer, too: prints the address to open, and stays until Ctrl-C.",
)
@click.option("--drag", is_flag=True, help="Like --view, with sliders and a target to drag (extra `viser`).")
@click.option("--sigma-mm", type=float, help=f"{SIGMA_HELP}.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of sampled poses.")
@shared_options(json_output=True)
def command(
    robot: str,
    file: str,
    goal: str,
    candidates: str | None,
    once: bool,
    every: float,
    view: bool,
    drag: bool,
    sigma_mm: float | None,
    seed: int,
    output: Output,
) -> None:
    """Follow FILE (CSV) while ROBOT is measured: how accurate it is, which pose to measure next, and when to stop.

    Each new line is predicted first, then fitted. A line that cannot be read is named, and skipped until it is
    corrected; with --once it is an error. The command ends when the goal is reached with 95 % confidence, or with
    Ctrl-C. With --json FILE, the file always holds the present state; with --json -, every state is one line.
    """
    if view and drag:
        raise InputError("--view and --drag each show a page of their own; leave one of them out")
    page = "--drag" if drag else "--view"
    if once and (view or drag):
        raise InputError(f"--once prints one answer and ends, so {page} has nothing to follow; leave one of them out")
    if goal.strip()[-1:].isdigit():
        raise InputError(f"--goal {goal}: write its unit, such as {goal.strip()}mm")
    length = quantity(goal, "length", "--goal")
    model = load_robot(robot, output)
    poses = None if candidates is None else different_poses(read_plan(candidates, model))
    watch = Watch(
        model, length, candidates=poses, sigma=None if sigma_mm is None else sigma_in_metres(sigma_mm), seed=seed
    )
    if once:
        progress = watch.update(read_measurements(file, model))
        _tell(progress, output)
        if progress.reason_without_fit is not None:
            raise progress.reason_without_fit
        output.remarks(watch.notes)
        return
    output.remarks(watch.notes)
    viewer = installed(page).live(model, drag) if view or drag else None
    try:
        _follow(watch, GrowingFile(file, model), every, viewer, output)
    except KeyboardInterrupt:
        output.note("ended")
    finally:
        if viewer is not None:
            viewer.close()


def _follow(watch: Watch, file: GrowingFile, every: float, viewer: Live | None, output: Output) -> None:
    """Report every change of the file until the goal holds; with a viewer, until Ctrl-C."""
    if viewer is not None:
        output.note(viewer.url)
    data = _read_changes(file, output)
    if viewer is not None and data is not None:  # earlier states, from the first poses on
        earlier = copy.deepcopy(watch)
        for part in _beginnings(data):
            viewer.remember(earlier.update(part))
    while True:
        progress = watch.update(data)
        _tell(progress, output)
        if viewer is not None:
            viewer.show(progress)
        if progress.stop and viewer is None:
            return
        data = None
        while data is None:
            time.sleep(every)
            data = _read_changes(file, output)


def _beginnings(data: Measurements) -> list[Measurements]:
    """Measurements of the first poses, for some numbers between few and nearly all, in geometric steps."""
    counts = np.unique(np.geomspace(LEAST, max(data.n_poses, LEAST), _BEGINNINGS).astype(int))
    return [data.subset(np.flatnonzero(data.pose_numbers < count)) for count in counts if count < data.n_poses]


def _read_changes(file: GrowingFile, output: Output) -> Measurements | None:
    """Measurements of the file if it has changed; prints the errors of skipped lines."""
    data = file.read_changes()
    output.remarks(file.remarks())
    return data


def _tell(progress: Progress, output: Output) -> None:
    output.say(f"{progress.report()}\n")
    if output.json_target == "-":
        click.echo(json.dumps(progress.to_dict(), allow_nan=False, ensure_ascii=False))
    elif output.json_target is not None:
        output.json(progress.to_dict())
