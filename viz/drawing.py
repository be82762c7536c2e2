"""The robot and its surroundings as meshcat commands.

meshcat's own objects would need its server and IPython; here the page replays packed commands without either. Paths:
`/meshcat/robot/<body>/<shape>` and `/meshcat/decorations/<shape>`. The page moves the bodies; everything lies in the
measurement frame, and `/meshcat` itself is turned upright.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.core.base.arrays import FloatArray
from viz.scene import ViewerScene
from viz.shapes import Shape

Command = dict[str, Any]
"""A command to meshcat's page, as meshcat defines it."""


def pack(command: Command) -> bytes:
    """Return a meshcat command as MessagePack bytes."""
    import umsgpack  # type: ignore[import-untyped]

    packed: bytes = umsgpack.packb(command)
    return packed


def body_path(scene: ViewerScene, body: int) -> str:
    """Return the path component of a body; numbered, because link names may contain slashes."""
    return f"{body} {scene.bodies.names[body].replace('/', '_')}"


def draw(scene: ViewerScene) -> list[bytes]:
    """Return the commands that draw the robot and its decorations."""
    upright = np.eye(4)
    upright[:3, :3] = scene.view.upright
    commands = [_transform("/meshcat", upright)]
    number = {name: body for body, name in enumerate(scene.bodies.names)}
    for k, shape in enumerate(scene.shapes):
        path = f"/meshcat/robot/{body_path(scene, number[str(shape.body)])}/{k}"
        commands += _draw_shape(path, shape, f"robot-{k}")
    for k, shape in enumerate(scene.decorations):
        commands += _draw_shape(f"/meshcat/decorations/{k}", shape, f"decoration-{k}")
    return [pack(command) for command in commands]


def _transform(path: str, T: FloatArray) -> Command:
    return {"type": "set_transform", "path": path, "matrix": T.T.ravel().tolist()}


def _draw_shape(path: str, shape: Shape, key: str) -> list[Command]:
    """Draw one shape; identifiers are set by hand so that the same scene gives the same bytes."""
    T = shape.T_body_shape
    if shape.kind == "cylinder":
        T = T @ np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])  # meshcat's cylinder lies along y
    red, green, blue, opacity = (float(part) for part in shape.colour)
    faceted = shape.kind == "mesh" and shape.body is not None
    material = {
        "uuid": f"{key}-material",
        "type": "MeshPhongMaterial" if faceted else "MeshLambertMaterial",  # the latter needs no graphics card
        "color": (round(255 * red) << 16) + (round(255 * green) << 8) + round(255 * blue),
        "side": 2,
        "transparent": opacity != 1,
        "opacity": opacity,
        "depthWrite": opacity >= 1.0,
    } | ({"specular": 0x1C1C1C, "shininess": 25, "flatShading": True} if faceted else {})
    geometry = {"uuid": f"{key}-geometry"} | _geometry(shape)
    mesh = {"uuid": key, "type": "Mesh", "geometry": geometry["uuid"], "material": material["uuid"]}
    drawn = {
        "metadata": {"version": 4.5, "type": "Object"},
        "geometries": [geometry],
        "materials": [material],
        "object": mesh | {"matrix": np.eye(4).ravel().tolist()},
    }
    return [{"type": "set_object", "object": drawn, "path": path}, _transform(path, T)]


def _geometry(shape: Shape) -> Command:
    if shape.kind == "box":
        width, height, depth = (float(edge) for edge in shape.size)
        return {"type": "BoxGeometry", "width": width, "height": height, "depth": depth}
    if shape.kind == "sphere":
        return {"type": "SphereGeometry", "radius": shape.size[0], "widthSegments": 20, "heightSegments": 20}
    if shape.kind == "cylinder":
        radius, height = shape.size
        size = {"radiusTop": radius, "radiusBottom": radius, "height": height}
        return {"type": "CylinderGeometry", **size, "radialSegments": 32}
    corners = _numbers(shape.vertices.astype(np.float32), "Float32Array", 0x17)
    faces = _numbers(shape.faces.astype(np.uint32), "Uint32Array", 0x16)
    return {"type": "BufferGeometry", "data": {"attributes": {"position": corners}, "index": faces}}


def _numbers(rows: NDArray[Any], kind: str, code: int) -> Command:
    import umsgpack

    return {"itemSize": 3, "type": kind, "array": umsgpack.Ext(code, rows.tobytes()), "normalized": False}
