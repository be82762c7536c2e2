"""`calib view`: look at a robot and its calibration."""

from __future__ import annotations

import os
import signal
import sys
import threading
from pathlib import Path
from types import FrameType

import click

from calib.core.base.errors import InputError
from calib.core.base.files import write_files
from calib.core.commands.common import Output, folder_of_values, load_robot, shared_options

MAP_POSES = 1000
"""Default number of poses of a map."""


@click.command("view")
@click.argument("robot")
@click.option(
    "--result", metavar="DIR", help="Result folder of `calib fit`: robot before and after, its poses and errors."
)
@click.option(
    "--data",
    metavar="FILE",
    help="Measurements (CSV) that judge the robot instead of those of the fit; or poses alone, for a view.",
)
@click.option(
    "--map",
    "mapped",
    is_flag=False,
    flag_value=MAP_POSES,
    default=0,
    type=click.IntRange(0, 20000),
    metavar="[COUNT]",
    help="Show predicted errors and their standard deviations at COUNT poses over the workspace"
    f" (--map alone: {MAP_POSES}), and ellipsoids at measured poses.",
)
@click.option("--html", metavar="FILE", help="Write one self-contained page instead, and end.")
@click.option("--rrd", metavar="FILE", help="Write a recording for rerun instead, and end (extra `rerun`).")
@click.option(
    "--drag", is_flag=True, help="Show it with viser: sliders, and a target to drag through space (extra `viser`)."
)
@click.option(
    "--port", type=click.IntRange(0, 65535), default=0, help="Port on this computer; any free one if not given."
)
@click.option("--no-browser", is_flag=True, help="Print the address only; open no browser.")
@shared_options()
def view(
    robot: str,
    result: str | None,
    data: str | None,
    mapped: int,
    html: str | None,
    rrd: str | None,
    drag: bool,
    port: int,
    no_browser: bool,
    output: Output,
) -> None:
    """Show ROBOT (YAML description, URDF or result folder) in a browser on this computer, until Ctrl-C."""
    from calib.core.data.plan_files import read_pose_files
    from viz.drag import DraggedView
    from viz.inputs import gather
    from viz.live import LiveViewer
    from viz.recording import recording
    from viz.viewer_page import scene_page

    if (html or rrd) is not None and (port or no_browser or drag):
        raise InputError("--html and --rrd write a file and start no server: leave out --port, --no-browser and --drag")
    model = load_robot(robot, output)
    if result is None and (result := folder_of_values(robot, None, None)) is not None:
        model = model.with_parameters([parameter.nominal_si for parameter in model.parameters])  # the nominal robot
    measurements = None if data is None else read_pose_files((data,), model)
    output.check(html, rrd)
    with output.working("preparing the scene"):
        shown = gather(model, result, measurements, mapped)
    for note in shown.scene.notes:
        output.note(f"Note: {note}")
    if html is not None:
        scene_page(shown.scene).save(html, force=output.force)
    if rrd is not None:
        write_files({Path(rrd): recording(shown.scene)}, comment=None, force=output.force)
    if written := [path for path in (html, rrd) if path is not None]:
        output.say(f"Written to {' and '.join(written)}")
        return
    with DraggedView(shown, port) if drag else LiveViewer(shown, port) as viewer:
        if no_browser:
            click.echo(viewer.url)  # also with --quiet, since nothing else shows the address
        else:
            output.say(viewer.url)
            _open(viewer.url)
        _wait_for_stop(output)


def _wait_for_stop(output: Output) -> None:
    """Wait for Ctrl-C or a request to terminate, then return so that the server is closed in order."""
    stop = threading.Event()

    def end(number: int, frame: FrameType | None) -> None:
        stop.set()

    previous = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
    output.note("Press Ctrl-C to end.")  # after the handlers are set
    try:
        while not stop.wait(1.0):  # an endless wait would keep signals out on some systems
            pass
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def _open(url: str) -> None:
    """Open a browser without waiting for it; do nothing without a desktop, where a text browser would start."""
    import webbrowser

    desktop = sys.platform in ("darwin", "win32") or "DISPLAY" in os.environ or "WAYLAND_DISPLAY" in os.environ
    if desktop:
        threading.Thread(target=webbrowser.open, args=(url,), daemon=True).start()
