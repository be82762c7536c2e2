"""`calib fleet`: the prior of the next robot of a model, from robots of the model."""

from __future__ import annotations

import click

from calib import pictures
from calib.core.commands.common import Output, shared_options
from calib.fleets.fleet import fleet, urdf_beside


@click.command("fleet")
@click.argument("results", nargs=-1, required=True, metavar="DIR DIR...")
@click.option(
    "-o",
    "--out",
    metavar="FILE",
    help="YAML file to write: the next robot, with its prior; its URDF is written beside it.",
)
@click.option(
    "--html",
    metavar="FILE",
    help="Write one page: parameters of all robots side by side, and which robots are unlike the others.",
)
@click.option(
    "-v",
    "--verbose",
    is_flag=True,
    help="Print all robots and parameters, not only those that differ most from the others and from nominal.",
)
@shared_options(json_output=True)
def command(results: tuple[str, ...], out: str | None, html: str | None, verbose: bool, output: Output) -> None:
    """Make the prior of the next robot of a model, from results of others.

    Each DIR is the result of `calib fit` or `calib match` for one robot, all with the same URDF and parameters, or a
    calibration of Universal Robots (YAML, as ur_calibration writes it). Poses, instruments and
    places may differ. The mean and spread of every parameter become the prior of the next robot, so that a few poses
    calibrate it. A robot that is unlike the others is named, and left out.
    """
    urdf = str(urdf_beside(out)) if out is not None else None
    with output.working(f"learning from {len(results)} results"):
        learned = fleet(*results)
    output.check(out, urdf, html)
    output.say(learned.report(verbose=verbose).rstrip())
    output.json(learned.to_dict())
    if out is not None:
        learned.save(out, force=output.force)
        output.say(f"{out} and {urdf} written; `calib fit {out} DATA --out DIR` calibrates one more robot")
    if html is not None:
        output.write(html, pictures.installed("--html").fleet(learned))
        output.say(f"Written to {html}")
