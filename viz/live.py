"""The live viewer: a page on this computer only, moved by the program that shows it."""

from __future__ import annotations

import html
import json
import math
import operator
import time

import numpy as np
from numpy.typing import ArrayLike

from calib import Fit, Progress
from calib.core.base.errors import DataError
from calib.core.base.units import millimetres
from calib.core.robots.configurations import joint_vector
from viz.bodies import posed_robot
from viz.inputs import ShownScene, gather
from viz.server import PageServer
from viz.viewer_page import scene_page

_PACE = 10  # number of states to estimate the time per pose


class LiveViewer:
    """A page for a browser on this computer, which this program can move.

    No call waits for a browser or fails without a browser. The server ends with this process, however it ends.

        with viz.show(robot, result) as viewer:
            print(viewer.url)
            viewer.show_pose(12)
            viewer.display(q)

    Args:
        shown: The scene and its robots.
        port: Port to listen on; 0 for any free port.

    Raises:
        InputError: The port is taken.
    """

    def __init__(self, shown: ShownScene, port: int = 0) -> None:
        self._shown = shown
        self._history: list[tuple[float | None, ...]] = []  # poses, predicted and unseen error, their 95 % ends [mm]
        self._fit: Fit | None = None
        self._pace: list[tuple[float, int]] = []  # time [s] and number of measured poses of the last states
        self._server = PageServer(scene_page(shown.scene, live=True).html, port)

    @property
    def url(self) -> str:
        """Address to open in a browser on this computer: secret, and sufficient to see the page."""
        return self._server.url

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks on the picture, such as missing meshes."""
        return self._shown.scene.notes

    def show_pose(self, index: int) -> None:
        """Go to a row of the page: a measured point, or a reading if no points were measured.

        Raises:
            DataError: There is no such row, or `index` is not a whole number.
        """
        count = self._shown.scene.n_rows
        try:
            row = operator.index(index)
        except TypeError:
            raise DataError(f"no pose {index!r}; give a whole number, counted from 0") from None
        if not 0 <= row < count:
            raise DataError(f"no pose {row}; the viewer shows {count} poses, counted from 0")
        self._server.send("pose", str(row), keep="pose")

    def display(self, q: ArrayLike) -> None:
        """Move the robots to actuated joint values, (n_actuated,) [m or rad], loops closed.

        The page shows these values and the predicted positions in place of a pose of the table.

        Raises:
            DataError: Joint values of the wrong shape.
            UnreachablePoseError: A loop cannot be closed.
        """
        shown = self._shown
        robots = {"solid": shown.solid, "ghost": shown.ghost}
        joints = joint_vector(shown.solid, q)
        if len(joints) != 1:
            raise DataError(f"joint values of shape {np.shape(q)}: give those of one pose at a time")
        moved = {
            name: None if robot is None else posed_robot(robot, shown.scene.bodies, joints).values[0].tolist()
            for name, robot in robots.items()
        }
        before = shown.solid if shown.ghost is None else shown.ghost
        after = None if shown.ghost is None else shown.solid
        predicted = {
            state: None if robot is None else robot.positions(joints)[0].tolist()
            for state, robot in (("before", before), ("after", after))
        }
        targets = list(shown.solid.target_names)
        content = {**moved, "joints": joints[0].tolist(), "targets": targets, "predicted": predicted}
        self._server.send("joints", json.dumps(content), keep="pose")

    def show(self, progress: Progress) -> None:
        """Show the progress after the poses measured so far, in the measuring cockpit above the picture.

        The verdict, the next pose and the errors come at once; then the new fit, with the robots at the next pose, or
        at the first pose of the table without a next one.
        """
        self._server.send("told", json.dumps(self._cockpit(progress), allow_nan=False), keep="told")
        if progress.fit is not None:
            self._shown = gather(progress.fit.nominal, progress.fit)
        self._server.forget("pose")
        self._server.replace(scene_page(self._shown.scene, live=True).html)
        if progress.next_pose is not None and not progress.stop:
            self.display(progress.next_pose.joints)

    def _cockpit(self, progress: Progress) -> dict[str, object]:
        """Data for the script of the page: the state, its words, earlier states, and the remaining time."""
        self.remember(progress)
        self._pace = [*self._pace[1 - _PACE :], (time.monotonic(), progress.n_poses)]
        (start, first), (end, last) = self._pace[0], self._pace[-1]
        left, each = progress.poses_left, (end - start) / (last - first) if last > first else None
        return progress.to_dict() | {
            "words": "\n".join((*progress.error_lines(), *self._change_lines(progress.fit))),
            "history": self._history,
            "seconds_left": None if left is None or each is None else left * each,
        }

    def remember(self, progress: Progress) -> None:
        """Add the progress after some poses to the curve towards the goal."""
        errors = (progress.predicted, progress.unseen)
        ends = [end for error in errors for end in (error.low95, error.high95)]
        known = [millimetres(one) if math.isfinite(one) else None for one in (*(e.value for e in errors), *ends)]
        if self._history and progress.n_poses <= (self._history[-1][0] or 0):  # lines were removed
            self._history = [row for row in self._history if (row[0] or 0) < progress.n_poses]
            self._pace = []
        self._history.append((progress.n_poses, *known))

    def _change_lines(self, fit: Fit | None) -> list[str]:
        """Lines on the effect of the last pose: the parameter that moved furthest, in its standard deviation."""
        before, self._fit = self._fit, fit
        if fit is None or before is None or before.free_names != fit.free_names:
            return []
        moved = {
            name: (fit.parameters[name].value - before.parameters[name].value, fit.parameters[name])
            for name in fit.free_names
            if fit.parameters[name].std > 0
        }
        if not moved:
            return []
        name, (by, estimate) = max(moved.items(), key=lambda item: abs(item[1][0]) / item[1][1].std)
        share = abs(by) / estimate.std
        return [f"Changed most by the last pose: {name}, {by:+.4f} {estimate.unit} ({share:.1f} standard deviations)"]

    def wait_for_browser(self, timeout: float) -> bool:
        """Wait for a connection from a browser, at most `timeout` seconds; return whether there is one."""
        return self._server.wait_for_browser(timeout)

    def close(self) -> None:
        """Stop the server and free its port; browsers keep the picture. Further calls do nothing."""
        self._server.close()

    def __enter__(self) -> LiveViewer:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _repr_html_(self) -> str:
        """Show the live page in a notebook cell, if the kernel runs on the browser's computer; else use `viz.page`."""
        return f'<iframe src="{html.escape(self.url)}" style="width: 100%; height: 640px; border: 0"></iframe>'
