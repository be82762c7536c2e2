"""The `medrue` program."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from calib.core.base.files import write_folder
from calib.core.base.units import from_unit
from calib.core.base.words import count_noun, listing
from calib.core.base.workers import Workers
from calib.core.commands.common import Output, shared_options
from calib.core.commands.program import run_program
from calib.core.data.measurement_files import format_positions
from calib.core.robots.loading import load
from medrue import measurement_file, page_files, robot_file

if TYPE_CHECKING:
    from medrue.pages import Report


_HELD_OUT = 0.8
"""Part of the poses of the demonstration that only judges the result."""


class NumberRange(click.FloatRange):
    """A range of numbers; `nan` is outside, although no comparison with the limits says so."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """See click."""
        number = super().convert(value, param, ctx)
        if math.isnan(number):
            self.fail(f"{value} is not a number.", param, ctx)
        return number


@click.group(name="medrue", context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="medrue", prog_name="medrue")
def group() -> None:
    """MedRUE, and the studies of the paper that calibrates it."""


@group.command("demo", short_help="Calibrate MedRUE from simulated measurements.")
@click.option(
    "-o",
    "--out",
    default="out/demo",
    show_default=True,
    metavar="DIR",
    help="Folder for the result, as of `calib fit`.",
)
@shared_options(json_output=True)
def demo_command(out: str, output: Output) -> None:
    """Calibrate MedRUE from the simulated measurements that come with the program: the main job, start to end."""
    from calib import fit, read_measurements
    from calib.core.results.results import RESULT_FILES, to_dict

    output.check(folders=(out,), names=RESULT_FILES)
    robot = load(robot_file())
    data = read_measurements(measurement_file(), robot)
    with output.working(f"calibrating MedRUE from {len(data)} poses"):
        result = fit(robot, data, validation=_HELD_OUT)
        result.save(out, force=output.force)
    output.json(to_dict(result))
    output.say(result.report())
    after, before = (float(str(result.errors["validation"][state]["rms"])) for state in ("after", "before"))
    used, held = len(result.identification.data), len(data) - len(result.identification.data)
    output.say(
        f"{used} of the {len(data)} simulated poses were used. At the other {held}, the RMS error of the tool"
        f" fell from {before:.2f} mm to {after:.3f} mm.\n"
        f"Open {Path(out) / 'report.html'} for the report, and {Path(out) / 'viewer.html'} to look at the robot.\n"
        "With a robot of your own: calib init YOUR.urdf --out robot.yaml"
    )


@group.command("examples", short_help="Write the files that the documentation uses.")
@shared_options()
def examples_command(output: Output) -> None:
    """Write the files that the pages of the documentation use: `urdf` and `docs/examples`, into the current folder.

    With them, every line of a tutorial runs without a checkout.
    """
    folders = page_files()
    for folder, files in folders.items():
        output.check(folders=(folder,), names=tuple(files))
    for folder, files in folders.items():
        write_folder(folder, {name: path.read_bytes() for name, path in files.items()}, force=output.force)
    count = sum(map(len, folders.values()))
    output.say(f"{count_noun(count, 'file')} written to {listing(sorted(folders))}")


@group.command("poses", short_help="Write the 420 poses of the target workspace.")
@click.option("-o", "--out", required=True, metavar="FILE", help="CSV file to write.")
@shared_options(json_output=True)
def poses_command(out: str, output: Output) -> None:
    """Write the 420 poses of the target workspace: joint values, and the nominal position of the tool."""
    from medrue.poses import pose_facts, target_poses

    output.check(out)
    robot = load(robot_file())
    with output.working("solving 420 poses"):
        poses = target_poses(robot)
        facts: Any = pose_facts(robot, poses)
    comments = (
        "420 poses on a half cylinder, 300 mm by 700 mm, around a patient's leg",
        "joint values by inverse kinematics through the closed loops, nominal parameters; tool: nominal position",
    )
    output.write(out, format_positions(robot, poses, robot.positions(poses.joints), comments))
    output.json(facts)
    (least, most), (mean, largest) = facts["q1_mm"], facts["probe_tilt_mean_and_largest_deg"]
    output.say(
        f"{len(poses)} poses written to {out}\n"
        "largest difference from the closed-form inverse:"
        f" {facts['largest_difference_from_closed_form_m_rad']:.1e} (m, rad)\n"
        f"q1 from {least:.1f} to {most:.1f} mm of 700 mm; probe tilted by {mean:.1f} deg on average, {largest:.1f} deg"
        " at most\n"
        "nearest to a singular pose: smallest singular value of the loops"
        f" {facts['smallest_singular_value_of_the_loops']:.3f}, smallest sine between two links"
        f" {facts['smallest_sine_between_links']:.3f} (0 is singular)"
    )


def _simulation_options(function: Callable[..., None]) -> Callable[..., None]:
    """Options that all simulations share."""
    options = (
        click.option(
            "-o", "--out", required=True, metavar="DIR", help="Folder to write tables, figures and a page to."
        ),
        click.option("--quick", is_flag=True, help="Few draws: seconds instead of minutes."),
        click.option("--draws", type=click.IntRange(min=2), help="Draws of the noise, instead of the usual number."),
        click.option(
            "-j",
            "--jobs",
            type=click.IntRange(min=1),
            default=os.cpu_count() or 1,
            show_default="all cores",
            help="Number of processes for the draws; results do not depend on it.",
        ),
        click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Seed of all draws."),
    )
    for option in reversed(options):
        function = option(function)
    return function


@group.command("study", short_help="Reproduce the paper's simulation study.")
@_simulation_options
@shared_options(json_output=True)
def study_command(out: str, quick: bool, draws: int | None, jobs: int, seed: int, output: Output) -> None:
    """Reproduce the paper's simulation study: Tables I and II, Figures 4 and 5. Everything is simulated."""
    output.check(folders=(out,))
    with Workers(jobs) as executor:  # they start while the rest is loaded
        from medrue.draws import Work
        from medrue.reports import study_report
        from medrue.study import QUICK, StudySize, run_study

        size = QUICK if quick else StudySize()
        size = replace(size, noise_draws=draws or size.noise_draws)
        study = run_study(load(robot_file()), size, seed, Work(executor, output.working))
    _finish(study_report(study), out, output, shown=("table2",))


@group.command("experiment", short_help="Reproduce the paper's experiment on a simulated robot.")
@_simulation_options
@click.option("--backlash-mm", type=NumberRange(0, 20), help="Backlash of the rail [mm].")
@click.option("--lead-um", type=NumberRange(-3000, 3000), help="Lead error [um per 300 mm].")
@click.option("--tilt-deg", type=NumberRange(0, 1), help="Tilt of the links' axes, one standard deviation [deg].")
@shared_options(json_output=True)
def experiment_command(
    out: str,
    quick: bool,
    draws: int | None,
    jobs: int,
    seed: int,
    backlash_mm: float | None,
    lead_um: float | None,
    tilt_deg: float | None,
    output: Output,
) -> None:
    """Reproduce the paper's experiment on a simulated robot: Tables III to V, Figures 3, 7 and 8.

    A second model has the robot's full geometry and the errors of its rail. It is identified from poses that are
    approached from both sides.
    """
    output.check(folders=(out,))
    with Workers(jobs) as executor:  # they start while the rest is loaded
        from medrue.both_sides import COUNTS, QUICK_COUNTS
        from medrue.draws import Work
        from medrue.experiment import DRAWS, QUICK_DRAWS, run_experiment
        from medrue.imperfections import Imperfections
        from medrue.reports import experiment_report

        usual = Imperfections()
        imperfections = Imperfections(
            usual.backlash if backlash_mm is None else from_unit(backlash_mm, "mm"),
            usual.lead if lead_um is None else lead_um * 1e-6 / 0.3,
            usual.tilt if tilt_deg is None else float(np.radians(tilt_deg)),
        )
        robots = load(robot_file()), load(robot_file("medrue_extended"))
        count, counts = (QUICK_DRAWS, QUICK_COUNTS) if quick else (DRAWS, COUNTS)
        work = Work(executor, output.working)
        experiment = run_experiment(*robots, draws or count, seed, work, imperfections, counts)
    _finish(experiment_report(experiment), out, output, shown=("table4", "table5"))


@group.command("touch", short_help="Calibrate without a tracker: by touch, or by encoders.")
@_simulation_options
@shared_options(json_output=True)
def touch_command(out: str, quick: bool, draws: int | None, jobs: int, seed: int, output: Output) -> None:
    """Calibrate without a tracker: by touched sockets, and by encoders on passive joints. Everything is simulated."""
    output.check(folders=(out,))
    with Workers(jobs) as executor:  # they start while the rest is loaded
        from medrue.draws import Work
        from medrue.reports import touch_report
        from medrue.touch import QUICK, SIZE, run_touch

        size = QUICK if quick else SIZE
        size = replace(size, noise_draws=draws or size.noise_draws)
        study = run_touch(load(robot_file()), size, seed, Work(executor, output.working))
    _finish(touch_report(study), out, output, shown=("world", "shape"))


def _finish(report: Report, out: str, output: Output, shown: tuple[str, ...]) -> None:
    """Write a report and say what is in it."""
    write_folder(out, report.files(), force=output.force)
    output.json(report.to_dict())
    for table in report.tables:
        if table.name in shown:
            output.say(f"{table.title}\n\n{table.text()}\n")
    for finding in report.findings:
        output.say(f"- {finding}")
    output.say(f"\nwritten to {out}; open {Path(out) / 'index.html'}")


def main() -> None:
    """Run the program."""
    run_program(group)
