"""A scene in viser, in a browser: sliders for joints and poses, and a target to drag.

`calib view ROBOT --drag` opens it in place of meshcat's page, and `calib watch ROBOT FILE --drag` while the robot is
measured. Links have their poses of `viz.bodies`, but are not stretched, because viser only moves rigid bodies.
"""

from __future__ import annotations

import contextlib
import io
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import calib
from calib import Progress
from calib.core.base.arrays import FloatArray
from calib.core.base.errors import CalibrationError, require_package
from calib.core.base.units import millimetres, quantity_text
from calib.core.base.version import DISTRIBUTION
from viz.bodies import posed_robot
from viz.inputs import ShownScene, gather
from viz.scene_data import colours, ranges

ADDRESS = "127.0.0.1"
_FIELD_OF_VIEW = np.radians(40.0)  # of the first camera, upright
_REACHED = 60  # poses over the joint limits that the first view holds
_HANDLES = 0.15  # of the scene's size: handles of the target
_DIGITS = 1  # of mm and degrees in the boxes beside sliders, which are narrow


class DraggedView:
    """A viser server whose page moves a robot by sliders and a target; use as a context.

    Args:
        shown: The scene and its robots.
        port: Port to listen on; 0 for any free port.

    Raises:
        InputError: viser is not installed.
    """

    def __init__(self, shown: ShownScene, port: int = 0) -> None:
        missing = "--drag shows the robot with viser, which is not installed: pip install viser"
        viser = require_package("viser", f"{missing} (or {DISTRIBUTION}[viser])")
        with _silence():
            self.server = viser.ViserServer(ADDRESS, port, label=shown.scene.title, verbose=False)
        self._draw(shown)
        self.move(shown.solid.home)

    def show(self, progress: Progress) -> None:
        """Show the progress after the poses measured so far: its words, the new fit, and the robot at the next pose."""
        if progress.fit is not None:
            self._draw(gather(progress.fit.nominal, progress.fit))
        self.words.content = "\n\n".join(line.strip() for line in progress.report().splitlines())
        if progress.next_pose is not None and not progress.stop:
            self.move(progress.next_pose.joints)

    def remember(self, progress: Progress) -> None:
        """Take note of the progress after some poses, of which this page shows none but the last."""

    def _draw(self, shown: ShownScene) -> None:
        self._shown, scene, space, gui = shown, shown.scene, self.server.scene, self.server.gui
        space.reset()
        gui.reset()
        space.add_frame("/scene", show_axes=False, wxyz=_wxyz(scene.view.upright))
        names = [f"/scene/{number}" for number in range(len(scene.bodies.names))]
        self._frames = [space.add_frame(name, show_axes=False) for name in names]
        for k, shape in enumerate((*scene.shapes, *scene.decorations)):
            place = "/scene/around" if shape.body is None else names[scene.bodies.names.index(shape.body)]
            red, green, blue = (round(255 * part) for part in shape.colour[:3])
            space.add_mesh_simple(
                f"{place}/shape{k}",
                *shape.triangles(),
                color=(red, green, blue),
                opacity=shape.colour[3],
                side="double",
                flat_shading=shape.kind == "mesh",
            )
        self._draw_errors()
        self._place_camera()
        self._moving = False
        self.words = gui.add_markdown("")
        self._sliders = [self._slider(k) for k in range(len(scene.joints))]
        target = shown.solid.target_names[0]
        self._target = space.add_transform_controls(
            f"/scene/{target}",
            scale=_HANDLES * scene.view.size,
            disable_rotations=True,
        )
        self._target.on_update(lambda _: self.reach(np.array(self._target.position)))
        if scene.n_rows:
            poses = gui.add_slider("row", 0, scene.n_rows - 1, 1, 0)
            every = np.concatenate([rows.joints for rows in scene.rows])
            poses.on_update(lambda _: self.move(every[int(poses.value)]))
        self.note = gui.add_markdown("")

    def _place_camera(self) -> None:
        """Let the first view hold everything: a sphere around it touches the edges of the picture.

        The robot is dragged, and led to next poses, so links and handles are held wherever the joints reach.
        """
        scene, solid, camera = self._shown.scene, self._shown.solid, self.server.initial_camera
        view, places = scene.view, [scene.view.outline]
        with contextlib.suppress(CalibrationError):  # no limits, say
            posed, links = solid.sample(_REACHED), [not name.startswith("(") for name in scene.bodies.names]
            T = scene.bodies.poses(posed_robot(solid, scene.bodies, posed), slice(None))[:, links]
            places.append(T[..., :3, 3].reshape(-1, 3) @ view.upright.T)
        every = np.concatenate(places)
        middle = (every.min(axis=0) + every.max(axis=0)) / 2
        radius = float(np.max(np.linalg.norm(every - middle, axis=1))) + _HANDLES * scene.view.size
        camera.look_at, camera.fov = middle, _FIELD_OF_VIEW
        camera.position = middle + radius / np.sin(_FIELD_OF_VIEW / 2) * view.direction

    @property
    def url(self) -> str:
        """Address to open in a browser on this computer."""
        return f"http://{ADDRESS}:{self.server.get_port()}"

    def move(self, joints: FloatArray) -> None:
        """Show the robot at actuated joint values, (n_actuated,) [m or rad], unless it cannot be assembled there."""
        scene, solid = self._shown.scene, self._shown.solid
        try:
            posed = posed_robot(solid, scene.bodies, joints[None, :])
            point = solid.positions(joints[None, :])[0, 0]
        except CalibrationError as error:
            self.note.content = str(error)
            return
        self.joints, self._moving = joints, True
        for frame, T in zip(self._frames, scene.bodies.poses(posed, 0), strict=True):
            frame.position, frame.wxyz = T[:3, 3], _wxyz(T[:3, :3])
        for slider, joint, value in zip(self._sliders, scene.joints, joints, strict=True):
            slider.value = round(float(joint.per_si * value), _DIGITS)
        self._target.position = point
        self._moving = False
        shown = ", ".join(f"{axis} {value:.3f}" for axis, value in zip("xyz", millimetres(point), strict=True))
        self.note.content = f"{solid.target_names[0]}: {shown} mm"

    def reach(self, point: FloatArray) -> None:
        """Bring the first target to a point, (3,) [m], if it is in reach."""
        if self._moving:
            return
        solution = calib.solve(self._shown.solid, point[None, :], near=self.joints)
        if solution.ok[0]:
            self.move(solution.q[0])
        else:
            self.note.content = f"not reached: {quantity_text(solution.miss_position[0], 'mm', '.2f')} short"

    def _slider(self, k: int) -> Any:
        joint, solid = self._shown.scene.joints[k], self._shown.solid
        limits = {one.name: (one.lower, one.upper) for one in solid.urdf.joints}
        ends = [
            end if np.isfinite(end) else side * np.pi for end, side in zip(limits[joint.name], (-1, 1), strict=True)
        ]
        step = 10.0**-_DIGITS
        low, high = step * np.ceil(joint.per_si * ends[0] / step), step * np.floor(joint.per_si * ends[1] / step)
        home = float(np.clip(joint.per_si * solid.home[k], low, high))
        slider = self.server.gui.add_slider(f"{joint.name} [{joint.unit}]", low, high, step, home)

        def follow(_: object) -> None:
            if not self._moving:
                joints = self.joints.copy()
                joints[k] = slider.value / joint.per_si
                self.move(joints)

        slider.on_update(follow)
        return slider

    def _draw_errors(self) -> None:
        """Draw the readings in the colours of their errors, and these errors enlarged."""
        scene = self._shown.scene
        state = (scene.states or ("before",))[-1]
        size = scene.view.size
        for rows, factor in zip(scene.rows, scene.factors, strict=True):
            known = np.isfinite(rows.anchors).all(axis=1) & np.isfinite(rows.sizes(state))
            if not np.any(known):
                continue
            begin, sizes = rows.anchors[known], rows.sizes(state)[known]
            highest = ranges({state: rows.sizes(state)}, rows.outlier)[state][1] or 1.0
            paint = (colours()[(255 * np.clip(sizes / highest, 0, 1)).astype(int), :3]).astype(np.uint8)
            name = rows.part.name.replace(" ", "_")
            self.server.scene.add_point_cloud(
                f"/scene/{name}", begin, paint, point_size=0.008 * size, point_shape="circle"
            )
            ends = np.stack([begin, begin + np.nan_to_num(factor[state] * rows.arrows(state)[known])], axis=1)
            self.server.scene.add_line_segments(
                f"/scene/{name}_errors", ends, np.repeat(paint[:, None], 2, axis=1), thickness=0.003 * size
            )

    def close(self) -> None:
        """Stop the server; the page then says that it has lost its program."""
        with _silence():
            self.server.stop()

    def __enter__(self) -> DraggedView:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def _silence() -> contextlib.redirect_stdout[io.StringIO]:
    """Keep viser's own lines off standard output, where an address or JSON is expected."""
    return contextlib.redirect_stdout(io.StringIO())


def _wxyz(rotation: FloatArray) -> tuple[float, float, float, float]:
    """Quaternion of a rotation, real part first."""
    x, y, z, w = Rotation.from_matrix(rotation).as_quat().tolist()
    return w, x, y, z
