"""A scene as a recording for rerun, `.rrd`: the robot pose by pose, readings with error arrows, and errors over poses.

The only timeline of the recording is `row`: the rows of the page, part by part. Errors are drawn in their place and
enlarged as on the page; `errors/PART/before` and `after` are their sizes in the unit of the part. `images/CAMERA` has
the points of each image as they were read, and arrows to where they were predicted, enlarged as well.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calib.core.base.arrays import IntArray
from calib.core.base.errors import require_package
from calib.core.base.units import in_unit
from calib.core.base.version import DISTRIBUTION
from calib.core.fitting.error_sets import STATES
from viz.charts import COLOURS
from viz.poses import EXCLUDED
from viz.reading_errors import ReadingErrors
from viz.scene import ViewerScene, nice_factor


def recording(scene: ViewerScene) -> bytes:
    """Return the recording of a scene, as the bytes of its file.

    Raises:
        InputError: rerun is not installed.
    """
    missing = f"--rrd needs rerun, which is not installed: pip install rerun-sdk (or {DISTRIBUTION}[rerun])"
    rr = require_package("rerun", missing)
    stream = rr.RecordingStream(f"calibration of {scene.title}")
    kept = stream.memory_recording()
    stream.log("scene", rr.Transform3D(mat3x3=scene.view.upright), rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    bodies = [f"scene/robot/{number}" for number in range(len(scene.bodies.names))]
    for k, shape in enumerate((*scene.shapes, *scene.decorations)):
        vertices, faces = shape.triangles()
        place = "scene/around" if shape.body is None else bodies[scene.bodies.names.index(shape.body)]
        colour = [round(255 * part) for part in shape.colour]
        drawn = rr.Mesh3D(vertex_positions=vertices, triangle_indices=faces, albedo_factor=colour)
        stream.log(f"{place}/{k}", drawn, static=True)
    first = 0
    of_robot = [np.arange(len(scene.shown)), *scene.pose_of_row] if scene.shows_poses else list(scene.pose_of_row)
    for rows, enlarged, poses in zip(scene.rows, scene.factors, of_robot, strict=True):
        name = rows.part.name.replace(" ", "_")
        known = np.isfinite(rows.anchors).all(axis=1)
        labels = [f"pose {label}{', left out' if group == EXCLUDED else ', outlier' if bad else ''}"
                  for label, group, bad in zip(rows.labels, rows.group, rows.outlier, strict=True)]  # fmt: skip
        points = rr.Points3D(rows.anchors[known], labels=np.array(labels)[known].tolist(), show_labels=False)
        stream.log(f"scene/{name}/read", points, static=True)
        for state in STATES:
            arrows = enlarged[state] * rows.arrows(state)
            drawn_too = known & np.isfinite(arrows).all(axis=1)
            every = rr.Arrows3D(origins=rows.anchors[drawn_too], vectors=arrows[drawn_too], colors=_rgb(COLOURS[state]))
            stream.log(f"scene/{name}/{state}", every, static=True)
        for row, pose in enumerate(poses):
            stream.set_time("row", sequence=first + row)
            for place, T in zip(bodies, scene.bodies.matrices(scene.solid, int(pose)), strict=True):
                stream.log(place, rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3]))
            for state in STATES:
                if np.isfinite(size := rows.sizes(state)[row]):
                    stream.log(f"errors/{name}/{state}", rr.Scalars(in_unit(size, rows.unit)))
        for row, instrument, image in _images(rows):
            stream.set_time("row", sequence=first + row)
            stream.log(f"images/{instrument}", rr.Points2D(rows.pixels[image]))
            for state, factor in _image_factors(rows).items():
                off, colour = factor * rows.residuals(state)[image], _rgb(COLOURS[state])
                flat = rr.Arrows2D(origins=rows.pixels[image], vectors=off, colors=colour)
                stream.log(f"images/{instrument}/{state}", flat)
        first += len(rows)
    content: bytes = kept.drain_as_bytes()
    return content


def _images(rows: ReadingErrors) -> Iterator[tuple[int, str, IntArray]]:
    """Yield each image of readings in pixels: its first row, its camera, and its rows."""
    if not rows.pixels.shape[1]:
        return
    names = list(zip(rows.labels, rows.instruments, strict=True))
    for name in dict.fromkeys(names):
        image = np.flatnonzero([other == name for other in names])
        yield int(image[0]), name[1], image


def _image_factors(rows: ReadingErrors) -> dict[str, float]:
    """Enlargement of the arrows of each state in images: most are at most a twentieth of the points' spread."""
    longest = 0.05 * float(np.max(np.ptp(rows.pixels, axis=0)))
    sizes = {state: rows.sizes(state) for state in STATES}
    return {state: nice_factor(float(np.nanmedian(of)), longest) for state, of in sizes.items() if np.any(of > 0)}


def _rgb(colour: str) -> list[int]:
    """Red, green and blue of a colour such as #0072B2, 0 to 255."""
    return [int(colour[k : k + 2], 16) for k in (1, 3, 5)]
