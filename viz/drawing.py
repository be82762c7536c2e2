"""The robot and its surroundings as meshcat commands, recorded instead of sent.

meshcat draws through a window whose `send` talks to a server. The stand-in here only packs and keeps the commands, so
no server, process or port is needed; the page replays them. Paths: `/meshcat/robot/<body>/<shape>` and
`/meshcat/decorations/<shape>`. The page moves the bodies; everything lies in the measurement frame, and `/meshcat`
itself is turned upright.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from viz.scene import Scene
from viz.shapes import Shape


class CommandRecorder:
    """A stand-in for `meshcat.visualizer.ViewerWindow` that keeps packed commands.

    Attributes:
        commands: MessagePack of each command, in order.
    """

    def __init__(self) -> None:
        self.commands: list[bytes] = []

    def send(self, command: Any) -> None:
        """Pack and keep one meshcat command."""
        self.commands.append(pack(command))


def pack(command: Any) -> bytes:
    """Return a meshcat command as the MessagePack bytes that its page understands."""
    import umsgpack  # type: ignore[import-untyped]

    packed: bytes = umsgpack.packb(command.lower())
    return packed


def load_meshcat() -> Any:
    """Import meshcat, silencing what it says about modules that it imports and that are none of our user's business."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        import meshcat
    return meshcat


def body_path(scene: Scene, body: int) -> str:
    """Return the path component of a body; numbered, because link names may hold slashes."""
    return f"{body} {scene.bodies.names[body].replace('/', '_')}"


def draw(scene: Scene) -> list[bytes]:
    """Return the commands that draw the robot and its decorations."""
    meshcat = load_meshcat()
    recorder = CommandRecorder()
    root = meshcat.Visualizer(window=recorder)
    upright = np.eye(4)
    upright[:3, :3] = scene.view.upright
    root.set_transform(upright)
    number = {name: body for body, name in enumerate(scene.bodies.names)}
    for k, shape in enumerate(scene.shapes):
        _draw_shape(root["robot"][body_path(scene, number[str(shape.body)])][str(k)], shape, f"robot-{k}")
    for k, shape in enumerate(scene.decorations):
        _draw_shape(root["decorations"][str(k)], shape, f"decoration-{k}")
    return recorder.commands


def _draw_shape(node: Any, shape: Shape, key: str) -> None:
    """Draw one shape; identifiers are set by hand so that the same scene gives the same bytes."""
    geometry = load_meshcat().geometry
    T = shape.T_body_shape
    drawn: Any
    if shape.kind == "box":
        drawn = geometry.Box([float(size) for size in shape.size])
    elif shape.kind == "sphere":
        drawn = geometry.Sphere(shape.size[0])
    elif shape.kind == "cylinder":
        drawn = geometry.Cylinder(shape.size[1], shape.size[0])
        drawn.radialSegments = 32
        T = T @ np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])  # meshcat's lies along y
    else:
        drawn = geometry.TriangularMeshGeometry(shape.vertices.astype(np.float32), shape.faces.astype(np.uint32))
    red, green, blue, opacity = (float(part) for part in shape.colour)
    colour = (round(255 * red) << 16) + (round(255 * green) << 8) + round(255 * blue)
    paint: dict[str, Any] = {"color": colour, "opacity": opacity, "depthWrite": opacity >= 1.0}
    if shape.kind == "mesh" and shape.body is not None:
        material = geometry.MeshPhongMaterial(specular=0x1C1C1C, shininess=25, flatShading=True, **paint)
    else:
        material = geometry.MeshLambertMaterial(**paint)  # cheap enough for computers without a graphics card
    object_ = geometry.Mesh(drawn, material)
    drawn.uuid, material.uuid, object_.uuid = f"{key}-geometry", f"{key}-material", key
    node.set_object(object_)
    node.set_transform(T)
