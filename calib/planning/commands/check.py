"""`calib check`: the parameters that a set of poses determines."""

from __future__ import annotations

import click

from calib.core.base.errors import InputError
from calib.core.base.files import write_folder
from calib.core.commands.common import (
    SIGMA_HELP,
    Output,
    folder_of_values,
    load_robot,
    shared_options,
    sigma_in_metres,
    values_options,
    with_values,
)
from calib.core.commands.next_steps import options_as_typed
from calib.core.data.measurement_files import read_poses
from calib.core.data.measurements import Measurements
from calib.core.data.plan_files import read_pose_files
from calib.core.fitting.pose_checks import wrapped_terms
from calib.core.judging.verdict import unordered
from calib.core.rows.observed import touches_without_target
from calib.pictures import figures
from calib.planning.assessment import check
from calib.planning.assessment_text import advice_after_check, text_report, to_dict
from calib.planning.pose_sampling import sample
from calib.shared.pose_check import check_poses
from calib.shared.pose_files import place_by_files


@click.command("check")
@click.argument("robot")
@click.argument("data", nargs=-1)
@click.option("--poses", type=int, default=100, show_default=True, help="Without DATA: how many poses to sample.")
@click.option(
    "--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Without DATA: seed of the sample."
)
@click.option("--task", metavar="FILE", help="Poses whose accuracy counts (CSV); those of DATA if not given.")
@click.option("--sigma-mm", type=float, help=f"{SIGMA_HELP}.")
@values_options
@click.option("--plots", metavar="DIR", help="Folder for figures: singular values, correlations, accuracy.")
@click.option("-v", "--verbose", is_flag=True, help="Print everything: all groups, and a table of all parameters.")
@shared_options(json_output=True)
def command(
    robot: str,
    data: tuple[str, ...],
    poses: int,
    seed: int,
    task: str | None,
    sigma_mm: float | None,
    parameters: str | None,
    result: str | None,
    plots: str | None,
    verbose: bool,
    output: Output,
) -> None:
    """Say which parameters of ROBOT the poses in DATA (CSV) determine, which combinations they do not, and why.

    DATA needs joint values only, so it can be checked before anything is measured. Rows with the same pose value
    count as repeats. Several files are joined as for `calib fit`. Without DATA, poses are spread over the joint limits.
    """
    sigma = None if sigma_mm is None else sigma_in_metres(sigma_mm)
    model = with_values(load_robot(robot, output), parameters, result)
    result = folder_of_values(robot, parameters, result)
    if not data:
        if poses < 1:
            raise InputError(f"--poses {poses}: at least one is needed")
        pose_set, source = sample(model, poses, seed), f"sampled over the joint limits, seed {seed}"
        if len(model.description.setups) > 1:
            output.note("note: all sampled poses are in the first setup; they do not test what another setup moves")
    else:
        pose_set, source = read_pose_files(data, model), ", ".join(data)
        if parameters is None and result is None:
            model = place_by_files(model, pose_set)
    for instrument in () if isinstance(pose_set, Measurements) else touches_without_target(model, pose_set):
        output.note(
            f"note: the poses do not say what '{instrument.name}' touches, or they are not at contact. Every pose"
            " counts as a touch of everything, so the result is too good (one socket does not show the robot's size)."
            f" Give poses at contact, with a column '{instrument.text_columns()[0]}'"
        )
    task_poses = None if task is None else read_poses(task, model)
    output.remarks(wrapped_terms(model, pose_set.joints))
    collisions = check_poses(model, pose_set.joints)
    output.check(folders=(plots,))
    with output.working(f"checking {len(pose_set)} poses"):
        assessment = check(model, pose_set, task=task_poses, sigma=sigma)
    output.remarks(unordered(pose_set) if isinstance(pose_set, Measurements) else collisions.notes)
    blocked = {name: hit for name, hit in zip(pose_set.names, collisions.hits, strict=True) if hit}
    for name, hit in zip(pose_set.names, collisions.hits, strict=True):
        if hit:
            output.alarm(f"pose {name}: {hit}")
    if collisions.n_blocked:
        output.alarm(collisions.summary())
    if plots is not None:
        write_folder(plots, figures(assessment), force=output.force)
    output.say(text_report(assessment, source, verbose=verbose))
    if plots is not None:
        output.say(f"Figures written to {plots}")
    output.say(advice_after_check(assessment, robot, pose_set, data, options_as_typed()))
    free = {"not_free": blocked, "collisions_unchecked": collisions.unchecked or None}
    output.json({"robot": model.path, "poses": source} | to_dict(assessment) | free)
