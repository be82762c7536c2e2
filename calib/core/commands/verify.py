"""`calib verify`: new measurements judge a calibrated robot."""

from __future__ import annotations

import re
from dataclasses import replace

import click
import numpy as np

from calib import pictures
from calib.core.base.errors import DataError, InputError, nearest
from calib.core.base.units import DISPLAY_UNIT, quantity
from calib.core.base.words import count_noun
from calib.core.commands.common import Output, load_robot, result_folder, shared_options
from calib.core.data.measurement_files import read_measurements, read_poses
from calib.core.judging.acceptance import poses_needed, verify, visible_changes
from calib.core.judging.acceptance_system import POWER, candidates
from calib.core.judging.promise import Promise
from calib.core.judging.repeatability import iso_figures
from calib.core.results.acceptance_text import changes_as_data, plan_report, text_report, to_dict
from calib.core.results.result_reading import load_result
from calib.core.robots.robot import Robot

_NOT_AS_PROMISED = 3
_DIGITS = 8  # decimals to which joint values of two files are compared [m or rad]


@click.command("verify")
@click.argument("robot")
@click.argument("data", nargs=-1, required=True)
@click.option("--result", metavar="DIR", help="Result folder of `calib fit`, if ROBOT is not one itself.")
@click.option(
    "--same-setup",
    is_flag=True,
    help="Keep unknown base and targets where the calibration found them. Default: place them anew.",
)
@click.option(
    "--plan", is_flag=True, help="DATA has joint values only: say which changes of the robot would show there."
)
@click.option(
    "--change", metavar="NAME=SIZE", help="With --plan: how many poses show this change, such as 'joint_2.z=0.2 mm'."
)
@click.option(
    "--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of the draws behind the intervals."
)
@click.option("--html", metavar="FILE", help="Write one page: the answer, errors of the readings, changes.")
@shared_options(json_output=True)
def command(
    robot: str,
    data: tuple[str, ...],
    result: str | None,
    same_setup: bool,
    plan: bool,
    change: str | None,
    seed: int,
    html: str | None,
    output: Output,
) -> None:
    """Judge the calibrated ROBOT by measurements DATA (CSV) that its calibration has not seen.

    The verdict says whether they agree with the calibration, whether one parameter or joint zero has drifted, or
    whether a new calibration is due (exit code 3 unless they agree). Repeated poses also give figures of ISO 9283.
    """
    if change and not plan:
        raise InputError("--change: needs --plan; without it, changes are found from the measurements")
    if plan and html:
        raise InputError("--html: is for readings; with --plan there are none yet")
    output.check(html)
    result = result_folder(robot, result)
    model = load_robot(robot, output)
    calibrated = load_result(result, model)
    promise = replace(calibrated.promise, robot=calibrated.robot)
    if plan:
        _plan(promise, data, change, same_setup, output)
        return
    measured = read_measurements(data, model)
    used = {tuple(q) for q in np.round(promise.joints, _DIGITS)}
    again = sum(tuple(q) in used for q in np.round(measured.joints, _DIGITS))
    if again:
        output.note(
            f"note: {again} of {count_noun(len(measured), 'visit')} have joint values that the calibration used. New"
            " readings there show whether the robot has changed; the readings that the calibration used do not"
        )
    with output.working(f"judging {count_noun(measured.n_readings, 'reading')}"):
        acceptance = verify(promise, measured, same_setup=same_setup)
        figures, missing = iso_figures(acceptance.errors, np.random.default_rng(seed))
    contains = calibrated.covariance.contains
    output.json({"robot": model.path, "seed": seed, **to_dict(acceptance, figures, missing, contains)})
    text = text_report(acceptance, figures, missing, contains)
    output.say(text)
    if html is not None:
        output.write(
            html, pictures.installed("--html").answer(acceptance, "New measurements of a calibrated robot", text, ())
        )
        output.say(f"Written to {html}")
    if acceptance.verdict != "agrees":
        raise click.exceptions.Exit(_NOT_AS_PROMISED)


def _plan(promise: Promise, data: tuple[str, ...], change: str | None, same_setup: bool, output: Output) -> None:
    """Print the changes that measurements at the poses of a file would show."""
    if len(data) > 1:
        raise InputError(f"--plan: {len(data)} files; give one with joint values")
    poses = read_poses(data[0], promise.robot)
    name, size = _change(promise.robot, change) if change else ("", 0.0)
    changes = visible_changes(promise, poses, same_setup=same_setup)
    content: dict[str, object] = {"n_poses": len(poses), "power": POWER, "changes": changes_as_data(changes)}
    lines = [plan_report(changes, data[0], len(poses))]
    if change:
        needed = poses_needed(promise, poses, name, size, same_setup=same_setup)
        content |= {"change": name, "poses_needed": needed}
        if needed is not None:
            lines.append(f"The first {count_noun(needed, 'pose')} show {change} with a chance of {100 * POWER:.0f} %")
        elif any(known.name == name for known in changes):
            lines.append(
                f"All {len(poses)} poses are too few to show {change} with a chance of {100 * POWER:.0f} %; add poses"
            )
        else:
            anew = "" if same_setup else ", or the new places of base and targets absorb it"
            lines.append(f"No number of such poses shows a change of {name}: readings do not depend on it{anew}")
    output.json(content)
    output.say("\n".join(lines))


def _change(robot: Robot, text: str) -> tuple[str, float]:
    """Name and size [m or rad] of NAME=SIZE."""
    name, equals, size = (part.strip() for part in text.partition("="))
    if not (name and equals and size):
        raise InputError(
            f"--change '{text}': write NAME=SIZE, such as 'joint_2.z=0.2 mm' or 'zero of joint_3=0.1 mrad'"
        )
    known = {change.name: change.dimension for change in candidates(robot)}
    if name not in known:
        raise DataError(f"--change: '{name}' is no parameter or joint zero that can change{nearest(name, known)}")
    if re.fullmatch(r"[\d.eE+-]+", size):  # a bare number could be in mm or in m
        raise InputError(f"--change '{text}': write the unit of the size, such as {size}{DISPLAY_UNIT[known[name]]}")
    value = quantity(size, known[name], f"--change {name}")
    if value == 0:
        raise DataError(f"--change '{text}': is not a change; give a size other than zero")
    return name, value
