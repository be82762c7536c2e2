"""`calib compare`: results side by side."""

from __future__ import annotations

import click

from calib import pictures
from calib.core.commands.common import Output, shared_options
from calib.fleets.comparing_results import compare


@click.command("compare")
@click.argument("results", nargs=-1, required=True, metavar="DIR DIR...")
@click.option("--html", metavar="FILE", help="Write one page: parameters with intervals, errors on the same readings.")
@shared_options(json_output=True)
def command(results: tuple[str, ...], html: str | None, output: Output) -> None:
    """Compare results of `calib fit`: parameters with 95 % intervals, errors, and which differences are real.

    Results are tested in pairs. Fits that used the same readings are shown but not tested.
    """
    output.check(html)
    with output.working(f"comparing {len(results)} results"):
        comparison = compare(*results)
    output.say(comparison.report().rstrip())
    output.json(comparison.to_dict())
    if html is not None:
        output.write(html, pictures.installed("--html").comparison(comparison))
        output.say(f"Written to {html}")
