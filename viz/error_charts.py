"""Plots of errors for each part of readings: their distribution, their places, and their dependence on joints."""

from __future__ import annotations

from itertools import combinations, pairwise
from typing import Any

import numpy as np

from calib import Fit
from calib.core.base.arrays import FloatArray, IntArray
from calib.core.base.units import in_unit, millimetres, quantity, quantity_text
from calib.core.fitting.error_sets import STATES
from calib.core.numerics import linalg
from viz.charts import COLOURS, Chart, PageRows, axis, layer, panel
from viz.poses import EXCLUDED, VALIDATION
from viz.reading_errors import ReadingErrors
from viz.remarks import tolerance
from viz.scene import ViewerJoint, ViewerScene
from viz.scene_data import colours, ranges

_MEANS = 12  # places along a joint at which residuals are averaged
_CELLS = 9  # cells along the longer side of a plane
_FLAT = 0.05  # places lie on a plane if their extent across it is below this part of their extent in it
_ALONG_AN_AXIS = 0.999  # the surface is parallel to one of the three planes if the cosine is more
_AT_REST = 1e-3  # errors whose places differ by less have one place [mm]
_TIMES = (("h", 3600.0), ("min", 60.0))
_PAIRED = 6  # largest number of joints whose ranges are drawn in all pairs; for more, neighbours only


def page_rows(scene: ViewerScene) -> PageRows:
    """Return hover text, pose and mark of each row of the page."""
    texts, keys, marks = [], [], []
    for rows in scene.rows:
        sizes = {state: rows.sizes(state) for state in STATES}
        several = len(set(rows.targets)) > 1 or not rows.part.is_position
        for k, (label, group, bad, target) in enumerate(
            zip(rows.labels, rows.group, rows.outlier, rows.targets, strict=True)
        ):
            known = [state for state in STATES if np.isfinite(sizes[state][k])]
            errors = [f"{quantity_text(sizes[state][k], rows.unit)} {state}" for state in known]
            who = f", {target}" if several else ""
            state = ", left out" if group == EXCLUDED else ", outlier" if bad else ""
            what = "" if rows.part.is_position else f"{rows.part.name} "
            texts.append(f"pose {label} ({group}{state}){who}: {what}error {', '.join(errors) or 'unknown'}")
            keys.append((group == VALIDATION, label))
            marks.append("x" if bad and group != EXCLUDED else "cross" if bad else
                         "diamond" if group == VALIDATION else "circle")  # fmt: skip
    numbers = {key: number for number, key in enumerate(dict.fromkeys(keys))}
    return PageRows(tuple(texts), tuple(numbers[key] for key in keys), tuple(marks))


def error_charts(fit: Fit, scene: ViewerScene) -> tuple[Chart, ...]:
    """Return the plots of every part of readings."""
    charts: list[Chart] = []
    for rows, numbers in _numbered_rows(scene):
        of_part = _Part(rows, numbers, scene.joints, tolerance(fit))
        if len(rows):
            planes = [of_part.planes()] if of_part.moves() else []
            charts += [of_part.distribution(), of_part.order(), *planes, of_part.joint_charts()]
    return tuple(charts)


def _numbered_rows(scene: ViewerScene) -> list[tuple[ReadingErrors, IntArray]]:
    """The rows of the page, part by part, and their numbers in its table."""
    ends = np.cumsum([len(rows) for rows in scene.rows]).tolist()
    return [(rows, np.arange(end - len(rows), end)) for rows, end in zip(scene.rows, ends, strict=True)]


def coverage(scene: ViewerScene, fit: Fit) -> Chart | None:
    """Return the poses in pairs of joints, within the limits of the joints; None without pairs."""
    joints, every = scene.joints, np.concatenate([rows.joints for rows in scene.rows])
    n = len(joints)
    pairs = list(combinations(range(n), 2)) if n <= _PAIRED else list(pairwise(range(n)))
    if not pairs or not len(every):
        return None
    small = len(pairs) > 3  # more than one row of panels
    _, one = np.unique(every, axis=0, return_index=True)  # each pose only once
    limits = {joint.name: (joint.lower, joint.upper) for joint in fit.nominal.urdf.joints}

    def coverage_of(k: int) -> Any:
        joint, own = joints[k], joints[k].per_si * every[:, k]
        low, high = (joint.per_si * end for end in limits.get(joint.name, (-np.inf, np.inf)))
        reach = max(float(np.ptp(own)), 1e-3)
        within = np.isfinite([low, high]).all() and high - low < 8 * reach
        low, high = (low, high) if within else (own.min(), own.max())
        space = 0.05 * (high - low)  # so that marks at the ends are whole
        return axis(f"{joint.name} [{joint.unit}]", ends=[low - space, high + space]), own[one]

    panels = []
    for a, b in pairs:
        (x, across), (y, up) = coverage_of(a), coverage_of(b)
        panels.append(panel(x, y, [layer("points", x=across, y=up, rows=one)], height=190 if small else 300))
    return Chart(
        "coverage",
        "Where the joints were",
        "The axes show the limits of each joint, or its measured range if the limits are far. Empty: not measured.",
        tuple(panels),
        170 if small else 300,
    )


def conditions(fit: Fit, scene: ViewerScene) -> Chart | None:
    """Return temperature and time of the poses in the order of measurement; None if the file has neither."""
    data = fit.identification.data
    row_of: dict[str, int] = {}
    for row, label in enumerate(label for part in scene.rows for label in part.labels):
        row_of.setdefault(label, row)
    panels = []
    chosen = [k for k, label in enumerate(data.names) if label in row_of]
    rows = np.array([row_of[data.names[k]] for k in chosen])
    for name in ("temperature", "time"):
        values = data.context[name][chosen] if name in data.context else np.zeros(0)
        if not len(values) or np.ptp(values) == 0:
            continue
        label = f"{name} [degC]"
        if name == "time":  # clocks count from 1970
            unit, seconds = next((time for time in _TIMES if np.ptp(values) > 10 * time[1]), ("s", 1.0))
            label, values = f"time [{unit}]", (values - values.min()) / seconds
        points = layer("points", "", COLOURS["after"], x=data.places[chosen] + 1.0, y=values, rows=rows)
        panels.append(panel(axis("pose, in the order of measurement"), axis(label), [points], height=220))
    text = "Compare with the errors in the order of measurement: select what stands out there."
    return Chart("conditions", "Conditions while measuring", text, tuple(panels), 400) if panels else None


class _Part:
    """Plots of one part of readings; `numbers` are its rows in the page's table, (n,)."""

    def __init__(self, rows: ReadingErrors, numbers: IntArray, joints: tuple[ViewerJoint, ...], layout: str) -> None:
        self._rows, self._numbers, self._joints = rows, numbers, joints
        self._unit = rows.unit
        self._limit = (
            in_unit(quantity(layout, "length", "tolerance"), rows.unit) if layout and rows.part.is_position else None
        )
        self._sizes = {state: in_unit(rows.sizes(state), rows.unit) for state in STATES}

    def _chart_name(self, name: str, title: str) -> tuple[str, str]:
        """Name and title of a chart; they name the part unless it is positions."""
        if self._rows.part.is_position:
            return name, title
        what = self._rows.part.name
        return f"{what.replace(' ', '-')}-{name}", f"{what.capitalize()}: {title[0].lower()}{title[1:]}"

    def distribution(self) -> Chart:
        """Share of errors below a size, before and after."""
        layers = []
        for state in STATES:
            known = np.flatnonzero(self._sizes[state] > 0)
            order = known[np.argsort(self._sizes[state][known], kind="stable")]
            line = {"x": self._sizes[state][order], "y": 100 * (np.arange(len(order)) + 1) / max(len(order), 1)}
            layers.append(layer("line", "", COLOURS[state], **line))
            layers.append(layer("points", state, COLOURS[state], **line, rows=self._numbers[order]))
        extra = ""
        if self._limit is not None:
            layers.append(layer("line", "tolerance", COLOURS["x"], x=[self._limit] * 2, y=[0.0, 100.0]))
            extra = " The tolerance is the upright line."
        x = axis(f"error [{self._unit}]", log=True)
        return Chart(
            *self._chart_name("errors", "Error before and after"),
            "The share of errors that are smaller: the further to the left, the better. The scale is logarithmic."
            + extra,
            (panel(x, axis("smaller [%]", ends=[0, 103]), layers),),
            600,
        )

    def moves(self) -> bool:
        """Whether the places of the errors differ; those of a camera mount that only turns are one."""
        places = millimetres(self._rows.anchors[np.isfinite(self._rows.anchors).all(axis=1)])
        return bool(len(places)) and float(np.ptp(places, axis=0).max()) > _AT_REST

    def planes(self) -> Chart:
        """Errors after calibration on three planes, with the mean of each cell."""
        places, size = millimetres(self._rows.anchors), self._sizes["after"]
        known = np.flatnonzero(np.isfinite(places).all(axis=1) & np.isfinite(size))
        known = known[np.argsort(size[known], kind="stable")]  # the largest on top
        usual = ~self._rows.outlier[known]
        limits = ranges({"after": self._rows.sizes("after")}, self._rows.outlier).get("after", [0, 1])
        highest = in_unit(limits[1], self._unit)
        palette = [f"#{r:02x}{g:02x}{b:02x}" for r, g, b, _ in colours().tolist()]

        def painted(values: FloatArray) -> list[str]:
            return [palette[int(255 * min(1.0, value / highest))] for value in values]

        panels = []
        for view, across, up, x, y in _views(places[known]):
            cells = _cells(x[usual], y[usual], size[known[usual]]) if usual.any() else None
            layers = [] if cells is None else [
                layer("cells", x=cells[0], y=cells[1], width=cells[3], height=cells[3], colours=painted(cells[2]),
                      texts=[f"mean error here {value:.3g} {self._unit}" for value in cells[2]])
            ]  # fmt: skip
            layers.append(layer("points", x=x, y=y, rows=self._numbers[known], colours=painted(size[known])))
            panels.append(panel(axis(f"{across} [mm]"), axis(f"{up} [mm]"), layers, title=view, equal=True))
        return Chart(
            *self._chart_name("planes", "Errors over the workspace, after calibration"),
            f"From dark (0) to bright ({highest:.3g} {self._unit} and more). A square shows the mean error of"
            " the poses in it, without outliers. No square: nothing was measured there.",
            tuple(panels),
        )

    def order(self) -> Chart:
        """Errors in the order of the file."""
        layers = []
        for state in STATES:
            known = np.flatnonzero(self._sizes[state] > 0)
            marks = {"x": known + 1.0, "y": self._sizes[state][known], "rows": self._numbers[known]}
            layers.append(layer("points", state, COLOURS[state], **marks))
        y = axis(f"error [{self._unit}]", log=True)
        return Chart(
            *self._chart_name("order", "Errors in the order of measurement"),
            "Steps or slopes show that something changed while measuring. Validation poses, and those left out,"
            " follow the others.",
            (panel(axis("reading"), y, layers, height=240),),
            600,
        )

    def joint_charts(self) -> Chart:
        """Residuals against each joint, with the local mean of each component."""
        left, axes = in_unit(self._rows.residuals("after"), self._unit), self._rows.part.axes
        usual = ~self._rows.outlier
        beyond = self._rows.outlier.any() and np.isfinite(left[usual]).any()
        reach = 1.2 * float(np.nanmax(np.abs(left[usual]))) if beyond else 0.0
        y = axis(f"residual [{self._unit}]", ends=[-reach, reach] if reach else None, beyond=reach > 0)
        panels = []
        for number, joint in enumerate(self._joints):
            values, layers, means = joint.per_si * self._rows.joints[:, number], [], []
            for k, (name, component) in enumerate(zip(axes, left.T, strict=False)):
                colour, known = COLOURS["xyz"[k % 3]], np.flatnonzero(np.isfinite(component))
                layers.append(
                    layer("points", name, colour, x=values[known], y=component[known], rows=self._numbers[known])
                )
                near = known[usual[known]]
                means.append(layer("line", "", colour, **_local_mean(values[near], component[near])))
            panels.append(panel(axis(f"{joint.name} [{joint.unit}]"), y, [*layers, *means], height=240))
        return Chart(
            *self._chart_name("by-joint", "Residuals against each joint"),
            "Predicted minus measured, with its local mean. If the line bends away from zero, the joint has an error"
            " that no parameter describes." + (" Outliers further off lie at the edge." if reach else ""),
            tuple(panels),
            280,
        )


def _views(places: FloatArray) -> list[tuple[str, str, str, FloatArray, FloatArray]]:
    """Planes of places (n, 3): title, names of both axes, and coordinates; also the plane of all places, if any."""
    x, y, z = places.T
    views = [("from above", "x", "y", x, y), ("from the side", "x", "z", x, z), ("from the front", "y", "z", y, z)]
    if len(places) > 3:
        _, extents, axes = linalg.svd(places - places.mean(axis=0), full_matrices=False)
        if extents[2] < _FLAT * extents[1] and np.abs(axes[2]).max() < _ALONG_AN_AXIS:
            along, across, _ = axes @ (places - places.mean(axis=0)).T
            views.append(("on the measured surface", "along", "across", along, across))
    return views


def _local_mean(values: FloatArray, component: FloatArray) -> dict[str, FloatArray]:
    """Means of a component over groups of neighbours along a joint, of about equal size."""
    order = np.argsort(values, kind="stable")
    pieces = [piece for piece in np.array_split(order, min(_MEANS, max(1, len(order) // 5))) if len(piece)]
    return {
        "x": np.array([values[piece].mean() for piece in pieces]),
        "y": np.array([component[piece].mean() for piece in pieces]),
    }


def _cells(x: FloatArray, y: FloatArray, size: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Middle (x, y), mean error and width of the cells with measurements in a plane."""
    width = max(float(np.ptp(x)), float(np.ptp(y)), 1e-6) / (_CELLS - 1)  # the outermost places are in the middle
    columns, lines = (np.rint((v - v.min()) / width).astype(int) for v in (x, y))
    numbers, of_cell, count = np.unique(columns * _CELLS + lines, return_inverse=True, return_counts=True)
    mean = np.bincount(of_cell, size) / count
    column, line = np.divmod(numbers, _CELLS)
    return x.min() + column * width, y.min() + line * width, mean, np.full(len(mean), width)
