"""A scene in viser, in a browser: sliders for joints and poses, and a target to drag.

`calib view ROBOT --drag` opens it in place of meshcat's page. Links have their poses of `viz.bodies`, but are not
stretched, because viser only moves rigid bodies.
"""

from __future__ import annotations

from types import TracebackType
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import calib
from calib.core.base.arrays import FloatArray
from calib.core.base.errors import CalibrationError, InputError
from viz.bodies import posed_robot
from viz.inputs import ShownScene
from viz.scene_data import colours, ranges, rows_of

ADDRESS = "127.0.0.1"


class DraggedView:
    """A viser server whose page moves a robot by sliders and a target; use as a context.

    Args:
        shown: The scene and its robots.
        port: Port to listen on; 0 for any free port.

    Raises:
        InputError: viser is not installed.
    """

    def __init__(self, shown: ShownScene, port: int = 0) -> None:
        try:
            import viser
        except ImportError:
            raise InputError("--drag shows the robot with viser, which is not installed: pip install viser") from None
        self._shown, scene = shown, shown.scene
        self.server = viser.ViserServer(ADDRESS, port, label=scene.title, verbose=False)
        space = self.server.scene
        space.add_frame("/scene", show_axes=False, wxyz=_wxyz(scene.view.upright))
        names = [f"/scene/{number}" for number in range(len(scene.bodies.names))]
        self._frames = [space.add_frame(name, show_axes=False) for name in names]
        for k, shape in enumerate((*scene.shapes, *scene.decorations)):
            place = "/scene/around" if shape.body is None else names[scene.bodies.names.index(shape.body)]
            colour, opacity = tuple(round(255 * part) for part in shape.colour[:3]), shape.colour[3]
            space.add_mesh_simple(f"{place}/shape{k}", *shape.triangles(), color=colour, opacity=opacity, side="double",
                                  flat_shading=shape.kind == "mesh")  # fmt: skip
        self._draw_errors()
        self.joints = shown.solid.home.copy()
        self._moving = False
        self._sliders = [self._slider(k) for k in range(len(scene.joints))]
        target = shown.solid.target_names[0]
        self._target = space.add_transform_controls(
            f"/scene/{target}", scale=0.2 * float(np.linalg.norm(scene.view.high - scene.view.low)),
            disable_rotations=True,
        )  # fmt: skip
        self._target.on_update(lambda _: self.reach(np.array(self._target.position)))
        if scene.n_rows:
            poses = self.server.gui.add_slider("row", 0, scene.n_rows - 1, 1, 0)
            every = np.concatenate([rows.joints for rows in rows_of(scene)])
            poses.on_update(lambda _: self.move(every[int(poses.value)]))
        self.note = self.server.gui.add_markdown("")
        self.move(self.joints)

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
            slider.value = float(joint.per_si * value)
        self._target.position = point
        self._moving = False
        shown = ", ".join(f"{axis} {1e3 * value:.3f}" for axis, value in zip("xyz", point, strict=True))
        self.note.content = f"{solid.target_names[0]}: {shown} mm"

    def reach(self, point: FloatArray) -> None:
        """Bring the first target to a point, (3,) [m], if it is in reach."""
        if self._moving:
            return
        solution = calib.solve(self._shown.solid, point[None, :], near=self.joints)
        if solution.ok[0]:
            self.move(solution.q[0])
        else:
            self.note.content = f"not reached: {1e3 * solution.miss_position[0]:.2f} mm short"

    def _slider(self, k: int) -> Any:
        """Add the slider of joint k within its limits."""
        joint, solid = self._shown.scene.joints[k], self._shown.solid
        limits = {one.name: (one.lower, one.upper) for one in solid.urdf.joints}
        ends = [
            end if np.isfinite(end) else side * np.pi for end, side in zip(limits[joint.name], (-1, 1), strict=True)
        ]
        low, high = (joint.per_si * end for end in ends)
        home = float(np.clip(joint.per_si * solid.home[k], low, high))
        slider = self.server.gui.add_slider(f"{joint.name} [{joint.unit}]", low, high, (high - low) / 1000, home)

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
        factors = scene.vector_factors if scene.shows_poses else scene.vector_factors[1:]
        size = float(np.linalg.norm(scene.view.high - scene.view.low))
        for rows, factor in zip(rows_of(scene), factors, strict=True):
            known = np.isfinite(rows.anchors).all(axis=1) & np.isfinite(rows.sizes(state))
            if not np.any(known):
                continue
            begin, sizes = rows.anchors[known], rows.sizes(state)[known]
            highest = ranges({state: rows.sizes(state)}, rows.outlier)[state][1] or 1.0
            paint = (colours()[(255 * np.clip(sizes / highest, 0, 1)).astype(int), :3]).astype(np.uint8)
            name = rows.part.name.replace(" ", "_")
            self.server.scene.add_point_cloud(f"/scene/{name}", begin, paint, point_size=0.008 * size)
            ends = np.stack([begin, begin + np.nan_to_num(factor[state] * rows.arrows(state)[known])], axis=1)
            self.server.scene.add_line_segments(
                f"/scene/{name}_errors", ends, np.repeat(paint[:, None], 2, axis=1), thickness=0.003 * size
            )

    def __enter__(self) -> DraggedView:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.server.stop()


def _wxyz(rotation: FloatArray) -> tuple[float, float, float, float]:
    """Quaternion of a rotation, real part first."""
    x, y, z, w = Rotation.from_matrix(rotation).as_quat().tolist()
    return w, x, y, z
