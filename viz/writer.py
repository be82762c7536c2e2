"""The pages of a result folder; registered in the entry point group `calib.reports`."""

from __future__ import annotations

from calib import Fit
from viz.report_page import command_line, report_page
from viz.scene import scene_of_fit
from viz.viewer_page import scene_page


def write(fit: Fit) -> dict[str, bytes]:
    """Return `report.html` and `viewer.html` of a fit."""
    return {
        "report.html": report_page(fit, command=command_line()).html.encode(),
        "viewer.html": scene_page(scene_of_fit(fit)).html.encode(),
    }
