"""`calib fit`: find the parameters that explain the measurements."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import click

from calib.calibration import fit
from calib.core.base.errors import ComputationError, InputError
from calib.core.base.files import image_address
from calib.core.base.registry import load_entry
from calib.core.base.words import count_noun
from calib.core.commands.common import (
    SIGMA_HELP,
    Output,
    jobs_option,
    load_robot,
    loss_option,
    shared_options,
    sigma_in_metres,
)
from calib.core.commands.next_steps import advice_after_fit, options_as_typed
from calib.core.data.measurement_files import read_measurements
from calib.core.data.measurements import Measurements
from calib.core.judging.rules_model import why_no_origins
from calib.core.results.results import RESULT_FILES, to_dict
from calib.core.robots.robot import Robot

_FOLDER = "out/robot"  # in the proposed next step, if the user named no folder


@click.command("fit")
@click.argument("robot")
@click.argument("data", nargs=-1, required=True)
@click.option(
    "--validate",
    metavar="FILE|FRACTION",
    help="Validate the result with other poses: those of a CSV file, or a part of DATA that the fit does not use"
    " (0.2: a fifth of the poses).",
)
@click.option(
    "--folds",
    metavar="N|setups",
    default="0",
    help="Cross-validation: split DATA into N parts and leave out each in turn; or leave out each setup.",
)
@click.option(
    "--sigma-mm",
    type=float,
    help=f"{SIGMA_HELP}. Noise that is not stated is found from the residuals.",
)
@loss_option
@click.option(
    "--terms",
    metavar="auto|none|LIST",
    help="Joint terms to add to those of the description. auto: those that improve the prediction of poses left out."
    " LIST: TERM for every joint or JOINT=TERM, such as curve,elbow=backlash. none: not even those of the description.",
)
@click.option(
    "--fix",
    metavar="NAMES",
    help="Parameters to hold as they are, such as joint_2.y,joint_3.z. all: every parameter except unknown places of"
    " base and targets.",
)
@click.option("--free", metavar="NAMES", help="Parameters to fit although the description or --fix all holds them.")
@click.option(
    "--prior",
    metavar="NAME=VALUE,...",
    help="How far off parameters are expected to be, one standard deviation with its unit, such as joint_3.z=0.1mm.",
)
@click.option(
    "--model",
    metavar="NAME|FILE",
    help="Prior of the robot's model: a known model such as ur5e, or a file that calib fleet wrote.",
)
@click.option("--exclude-outliers", is_flag=True, help="Leave outliers out and fit again; show both results.")
@click.option("--starts", type=int, default=1, show_default=True, help="Number of starting points.")
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    help="Seed of the random choice of held-out poses, folds and starting points.",
)
@jobs_option("folds and starts")
@click.option("-v", "--verbose", is_flag=True, help="Print everything: all reasons, tables and remarks.")
@click.option("--no-pages", is_flag=True, help="Do not write report.html and viewer.html; this saves most of the time.")
@click.option("--logo", metavar="FILE", help="PNG, JPEG or SVG image (up to 512 kB) to put into report.html.")
@click.option(
    "-o",
    "--out",
    metavar="DIR",
    help="Folder for the result. If not given, the result is printed, and nothing is written.",
)
@shared_options(
    json_output=True,
    forced="Write calibrated.urdf even after FAIL, or if it is worse than the nominal robot; the file says so. Also"
    " replace files that this program did not write, or that this command reads.",
)
def command(
    robot: str,
    data: tuple[str, ...],
    validate: str | None,
    folds: str,
    sigma_mm: float | None,
    loss: str,
    terms: str | None,
    fix: str | None,
    free: str | None,
    prior: str | None,
    model: str | None,
    exclude_outliers: bool,
    starts: int,
    seed: int,
    jobs: int,
    verbose: bool,
    no_pages: bool,
    logo: str | None,
    out: str | None,
    output: Output,
) -> None:
    """Calibrate ROBOT (YAML description, URDF or result folder) from the measurements DATA (CSV, or a ROS 2 bag).

    With several files, those with joint columns give the visits. The others have a column `pose` that says to which
    visit each row belongs.
    """
    if logo is not None:
        if no_pages or out is None:
            raise InputError(f"--logo is for report.html: {'leave out --no-pages' if no_pages else 'give --out DIR'}")
        image_address(logo)
    described = load_robot(robot, output)
    if model is not None:
        path = str(Path(model).resolve()) if Path(model).is_file() else model
        described = load_entry("calib.methods", "with_model")(described, path)
    identification = read_measurements(data, described)
    validation = None
    if validate is not None:
        identification, validation = _hold_out(described, identification, validate, seed)
    sigma = None if sigma_mm is None else sigma_in_metres(sigma_mm)
    output.check(folders=(out,), names=RESULT_FILES)
    with output.working(f"fitting {count_noun(len(identification), 'pose')}") as progress:
        result = fit(
            described,
            identification,
            validation=validation,
            sigma=sigma,
            loss=loss,
            exclude_outliers=exclude_outliers,
            starts=starts,
            folds=_folds(folds),
            seed=seed,
            terms=terms,
            fix=_names(fix),
            free=_names(free),
            prior=_priors(prior),
            executor=jobs,
            progress=progress,
        )
    result = replace(result, requested_options=replace(result.requested_options, validation=validate or ""))
    failed = result.verdict.grade == "FAIL"
    if out is not None:
        result.save(out, force=output.force, pages=not no_pages, logo=logo)
    output.say(result.report(verbose=verbose))
    output.say(
        _result_lines(Path(out)) if out is not None else "Nothing is written: --out DIR writes report, viewer, URDF"
    )
    withheld = "" if out is None or failed or output.force else why_no_origins(result)
    if withheld:
        output.note(f"note: calibrated.urdf was not written: {withheld} (--force writes it)")
    folder = _FOLDER if out is None else out
    output.say(advice_after_fit(result, robot, data, folder, options_as_typed(), written=out is not None))
    if output.json_target is not None:
        output.json(to_dict(result, forced=failed and output.force))
    if failed and not output.force:
        unwritten = "" if out is None else "; calibrated.urdf was not written (--force writes it)"
        raise ComputationError(f"verdict FAIL: {result.verdict.reasons[0].text}{unwritten}")


def _result_lines(folder: Path) -> str:
    names = ("report.html", "viewer.html", "calibrated.urdf", "result.json")
    return f"Written to {folder}: {', '.join(name for name in names if (folder / name).exists())} and others"


def _folds(text: str) -> int | Literal["setups"]:
    if text == "setups":
        return "setups"
    try:
        return int(text)
    except ValueError:
        raise InputError(f"--folds {text}: must be a number of folds, or 'setups'") from None


def _names(text: str | None) -> tuple[str, ...]:
    return () if text is None else tuple(name.strip() for name in text.split(",") if name.strip())


def _priors(text: str | None) -> dict[str, str]:
    """The prior of each name in a typed list; a bare number could be in mm or in m."""
    priors = {}
    for entry in _names(text):
        name, equals, value = (part.strip() for part in entry.rpartition("="))
        if not equals or value[-1:].isdecimal():
            raise InputError(f"--prior {entry}: is not a name and a value with its unit, such as joint_3.z=0.1mm")
        if name in priors:
            raise InputError(f"--prior {entry}: '{name}' is given twice")
        priors[name] = value
    return priors


def _hold_out(robot: Robot, data: Measurements, validate: str, seed: int) -> tuple[Measurements, Measurements]:
    try:
        fraction = float(validate)
    except ValueError:
        if not Path(validate).exists():
            raise InputError(f"--validate {validate}: is neither a file nor a fraction such as 0.2") from None
        return data, read_measurements(validate, robot)
    return data.split(validation=fraction, seed=seed)
