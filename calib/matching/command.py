"""`calib match`: a robot that agrees with the poses that its controller prints."""

from __future__ import annotations

from collections.abc import Sequence

import click

from calib.core.base.errors import ComputationError, InputError
from calib.core.commands.common import Output, load_robot, shared_options
from calib.matching.match import match
from calib.matching.result import FILES


@click.command("match")
@click.argument("robot")
@click.argument("pairs")
@click.option(
    "--tool",
    metavar="POSE",
    help="Tool that the controller adds to the last link, written like the poses of PAIRS, such as 0,0,150,0,0,0; found"
    " if not given.",
)
@click.option(
    "--base",
    metavar="POSE",
    help="Place of the robot's base in the controller's base frame, written like --tool; found if not given.",
)
@click.option(
    "--no-terms",
    is_flag=True,
    help="Do not try joint terms (gravity, couplings) where joint origins explain too little.",
)
@click.option(
    "--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of the simulated rounding."
)
@click.option(
    "-o",
    "--out",
    metavar="DIR",
    help="Folder for the result: URDF, Denavit-Hartenberg tables, xacro, Universal Robots' default_kinematics.yaml. If"
    " not given, the result is printed, and nothing is written.",
)
@shared_options(json_output=True)
def command(
    robot: str,
    pairs: str,
    tool: str | None,
    base: str | None,
    no_terms: bool,
    seed: int,
    out: str | None,
    output: Output,
) -> None:
    """Find the joint origins that reproduce the poses of ROBOT's controller. No instrument is needed.

    Each row of PAIRS has joint values and the pose that the controller (pendant) shows for them; 30 rows in which all
    joints turn far are good. The columns may be those of Universal Robots (rotation vectors), ABB (quaternions), KUKA
    (A, B, C), FANUC (W, P, R), Stäubli and others; what they mean is found and printed. ROBOT is the stock URDF, a
    robot description, or a calibration of Universal Robots (YAML).
    """
    model = load_robot(robot, output)
    output.check(folders=(out,), names=("match.json", *FILES.values()))
    with output.working("matching"):
        result = match(
            model,
            pairs,
            tool=_numbers(tool, "--tool"),
            base=_numbers(base, "--base"),
            terms=not no_terms,
            seed=seed,
        )
    output.say(result.report())
    output.json(result.to_dict())
    if out is not None:
        written = result.save(out, force=output.force)
        output.say(f"Written to {out}: {', '.join(written)}")
    if result.grade == "FAIL" and not output.force:
        raise ComputationError("verdict FAIL: no joint origins bring the robot to these poses (--force writes it)")


def _numbers(text: str | None, option: str) -> Sequence[float] | None:
    if text is None:
        return None
    try:
        return [float(part) for part in text.replace(",", " ").split()]
    except ValueError:
        raise InputError(f"{option} {text}: should be numbers, such as 0,0,150,0,0,0") from None
