"""Pictures of robots and calibrations: a viewer in the browser, live or as a file, and a report to print.

* `viz.show(robot, result)`: live, in a browser on this computer.
* `viz.page(robot, result).save("viewer.html")`: one file that opens without a server; it shows itself in a notebook.
* `viz.report(result).save("report.html")`: one file to read and to print.
"""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from calib import Fit, Measurements, Robot
    from viz.inputs import Result
    from viz.live import LiveViewer
    from viz.viewer_page import ViewerPage

__all__ = ["PictureWarning", "page", "report", "show"]


class PictureWarning(UserWarning):
    """A part of the picture could not be drawn, such as a missing mesh."""


def show(
    robot: Robot,
    result: Result | None = None,
    *,
    data: Measurements | None = None,
    port: int = 0,
    mapped: int = 0,
) -> LiveViewer:
    """Show a robot and its calibration live: open the viewer's `.url` in a browser on this computer.

    Args:
        robot: The nominal robot.
        result: A fit, or the folder of a saved fit.
        data: Measurements to compare with the robots, instead of those of the fit.
        port: Port to listen on, on this computer only; 0 for any free port.
        mapped: Number of poses of the map of the uncertainty over the workspace; 0: no map.

    Raises:
        DataError: The folder holds no result of this robot.
        UnreachablePoseError: A pose cannot be assembled.
        InputError: The port is taken.
    """
    from viz.inputs import gather
    from viz.live import LiveViewer

    viewer = LiveViewer(gather(robot, result, data, mapped), port)
    _warn(viewer.notes)
    return viewer


def page(
    robot: Robot, result: Result | None = None, *, data: Measurements | None = None, mapped: int = 0
) -> ViewerPage:
    """Return the viewer as one self-contained page, with the arguments of `show`."""
    from viz.inputs import gather
    from viz.viewer_page import scene_page

    scene = gather(robot, result, data, mapped).scene
    _warn(scene.notes)
    return scene_page(scene)


def report(result: Fit, *, command: str = "") -> ViewerPage:
    """Return the report of a fit as one self-contained page; it prints `command`, the command line of the fit."""
    from viz.report_page import report_page

    return report_page(result, command=command)


def _warn(notes: tuple[str, ...]) -> None:
    for note in notes:
        warnings.warn(note, PictureWarning, stacklevel=3)
