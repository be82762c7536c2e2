"""The entries of the group `calib.pictures`: a command, the pages of a fit, figures.

Imports happen at first use, so that `calib --help` stays quick.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from calib.core.base.threads import one_blas_thread

if TYPE_CHECKING:
    from calib import Fit, Fleet, ResultComparison, Robot
    from viz.command import view as command
    from viz.drag import DraggedView
    from viz.fit_plots import FitPlots
    from viz.live import LiveViewer

__all__ = ["answer", "command", "comparison", "figures", "fleet", "live", "pages", "plots", "summary"]

summary = "Show a robot and its calibration in a browser."


@one_blas_thread
def pages(fit: Fit, logo: str = "") -> dict[str, bytes]:
    """Return `report.html` and `viewer.html` of a fit; the report shows `logo`, an address from `image_address`."""
    from viz.judgement import judgement_of_fit
    from viz.report_page import command_line, report_page
    from viz.scene import scene_of_fit
    from viz.viewer_page import scene_page

    command = command_line()
    scene = scene_of_fit(fit, judgement_of_fit(fit, command))
    report = report_page(fit, command=command, viewer="viewer.html", logo=logo, scene=scene)
    return {
        "report.html": report.html.encode(),
        "viewer.html": scene_page(scene, report="report.html").html.encode(),
    }


def comparison(result_comparison: ResultComparison) -> bytes:
    """Return the page of results side by side."""
    from viz.comparison_page import comparison_page
    from viz.report_page import command_line

    return comparison_page(result_comparison, command=command_line()).html.encode()


def fleet(learned: Fleet) -> bytes:
    """Return the page of robots of one model side by side."""
    from viz.comparison_page import fleet_page
    from viz.report_page import command_line

    return fleet_page(learned, command=command_line()).html.encode()


def answer(subject: object, title: str, text: str, figures: Sequence[tuple[int, str]]) -> bytes:
    """Return the page of an acceptance, a hand-eye calibration or a detection; see `answer_page`."""
    from viz.answer_page import answer_page

    return answer_page(subject, title, text, figures).html.encode()


def figures(subject: object) -> dict[str, bytes]:
    """Return the figures of an assessment or a selection as SVG files; the same input gives the same bytes.

    Raises:
        TypeError: `subject` is something else.
    """
    from calib.planning.assessment import Assessment
    from calib.planning.selection_result import Selection
    from viz.selection_plots import assessment_figures, selection_figures

    if isinstance(subject, Assessment):
        return assessment_figures(subject)
    if isinstance(subject, Selection):
        return selection_figures(subject)
    raise TypeError(f"no figures of {type(subject).__name__}")


def plots(fit: Fit) -> FitPlots:
    """Return the figures of a fit as methods that draw into axes."""
    from viz.fit_plots import FitPlots

    return FitPlots(fit)


def live(robot: Robot, dragged: bool = False) -> LiveViewer | DraggedView:
    """Return a live page that shows a robot until its first update; `dragged`: by viser.

    Raises:
        InputError: `dragged`, and viser is not installed.
    """
    from viz.drag import DraggedView
    from viz.inputs import gather
    from viz.live import LiveViewer

    return DraggedView(gather(robot)) if dragged else LiveViewer(gather(robot))


def __getattr__(name: str) -> Any:
    if name != "command":
        raise AttributeError(f"module 'viz.pictures' has no attribute '{name}'")
    from viz.command import view

    return view
