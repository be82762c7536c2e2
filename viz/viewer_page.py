"""The viewer as one self-contained HTML file: opens from disk, needs no server, asks nobody for anything."""

from __future__ import annotations

import base64
import html
import json
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.files import write_file
from calib.model.mechanism import FloatArray
from calib.version import VERSION
from viz.bodies import Bodies, Figure
from viz.drawing import body_path, draw, load_meshcat
from viz.poses import GROUPS
from viz.scene import Scene

_SCRIPTS = ("kinematics.js", "marks.js", "stage.js", "panel.js", "controls.js", "start.js")
_COLOURS = "viridis"  # even in lightness, and told apart with any colour vision
_EXACT = 1e-12  # [m]: smallest range of colours, where nothing is wrong anywhere
_POINT_RADIUS = (0.0025, 0.008)  # of the scene's size: of points that crowd, and of points with room


@dataclass(frozen=True)
class Page:
    """A finished page.

    Attributes:
        html: The whole file.
    """

    html: str

    def save(self, path: Path | str) -> Path:
        """Write the page, or leave what was there untouched.

        Raises:
            InputError: The file cannot be written.
        """
        write_file(path, self.html)
        return Path(path)

    def _repr_html_(self) -> str:
        """Show the page inside a notebook cell; works with a kernel on another machine, too."""
        return f'<iframe srcdoc="{html.escape(self.html)}" style="width: 100%; height: 640px; border: 0"></iframe>'


def scene_page(scene: Scene, *, live: bool = False) -> Page:
    """Return the viewer page of a scene.

    Args:
        scene: What to show.
        live: Whether the page listens to the server that sends it.
    """
    from jinja2 import Environment, PackageLoader

    templates = files("viz") / "templates"
    scripts = "\n".join(
        (templates / name).read_text(encoding="utf-8").replace('"use strict";\n', "") for name in _SCRIPTS
    )
    code, licences = meshcat_script()
    environment = Environment(loader=PackageLoader("viz", "templates"), autoescape=True)
    text = environment.get_template("viewer.html").render(
        title=scene.title,
        version=VERSION,
        live=live,
        licences=licences,
        meshcat=in_script(code),
        style=(templates / "viewer.css").read_text(encoding="utf-8"),
        script=in_script('"use strict";\n' + scripts),
        scene=json_in_script(scene_data(scene, live=live)),
    )
    return Page(text)


def meshcat_script() -> tuple[str, str]:
    """Return meshcat's viewer (with three.js) and its licences."""
    folder = Path(load_meshcat().__file__).parent / "viewer" / "dist"
    return (
        (folder / "main.min.js").read_text(encoding="utf-8"),
        (folder / "main.min.js.LICENSE.txt").read_text(encoding="utf-8"),
    )


def in_script(code: str) -> str:
    """Return code that cannot end the script element that holds it."""
    return code.replace("</script", "<\\/script").replace("<!--", "<\\!--")


def json_in_script(data: object) -> str:
    """Return JSON in which no text can end the script element that holds it."""
    text = json.dumps(data, allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    for letter, code in (
        ("<", "\\u003c"),
        (">", "\\u003e"),
        ("&", "\\u0026"),
        ("\u2028", "\\u2028"),
        ("\u2029", "\\u2029"),
    ):
        text = text.replace(letter, code)
    return text


def scene_data(scene: Scene, *, live: bool = False) -> dict[str, Any]:
    """Return the scene as the page's script reads it; arrays as base64, unknown numbers as NaN inside these."""
    bodies, table = scene.bodies, scene.poses
    names = [body for body, name in enumerate(bodies.names) if not name.startswith("(")]
    noise = float(np.median(table.sigma[np.isfinite(table.sigma)])) if np.any(np.isfinite(table.sigma)) else None
    return {
        "title": scene.title,
        "live": live,
        "notes": list(scene.notes),
        "verdict": None
        if scene.verdict is None
        else {"grade": scene.verdict.grade, "reasons": [reason.text for reason in scene.verdict.reasons]},
        "groups": list(GROUPS),
        "states": list(scene.states),
        "joints": [{"name": joint.name, "unit": joint.unit, "per_si": joint.per_si} for joint in scene.joints],
        "bodies": _bodies(scene.bodies),
        "body_paths": [body_path(scene, body) for body in range(len(bodies.names))],
        "frames": [{"body": body, "name": bodies.names[body]} for body in names],
        "solid": _figure(scene.solid),
        "ghost": None if scene.ghost is None else _figure(scene.ghost),
        "commands": [base64.b64encode(command).decode() for command in draw(scene)],
        "n_decorations": len(scene.decorations),
        "vector_factors": scene.vector_factors,
        "ghost_factor": scene.ghost_factor,
        "view": {
            "low": scene.view.low.tolist(),
            "high": scene.view.high.tolist(),
            "outline": scene.view.outline.tolist(),
            "direction": scene.view.direction.tolist(),
        },
        "table": _table(scene),
        "summary": summary(scene),
        "noise": noise,
        "range": ranges(scene),
        "colours": _encode(colours()),
        "point_radius": point_radius(scene),
    }


def _bodies(bodies: Bodies) -> dict[str, Any]:
    return {
        "parents": bodies.parents.tolist(),
        "axes": bodies.axes.tolist(),
        "sliding": list(bodies.sliding),
        "columns": bodies.columns.tolist(),
        "base": bodies.base,
    }


def summary(scene: Scene) -> list[dict[str, Any]]:
    """Return count, mean and largest error [mm] of each group, before and after calibration where known."""
    rows = []
    group = np.array(scene.poses.group)
    for name in GROUPS:
        chosen = group == name
        row: dict[str, Any] = {"group": name, "count": int(np.sum(chosen))}
        for state in scene.states:
            lengths = np.linalg.norm(scene.poses.error(state)[chosen], axis=1)
            lengths = 1e3 * lengths[np.isfinite(lengths)]
            row[state] = {"mean": float(lengths.mean()), "max": float(lengths.max())} if len(lengths) else None
        if row["count"] and scene.states:
            rows.append(row)
    return rows


def ranges(scene: Scene) -> dict[str, list[float]]:
    """Return the error [m] at both ends of the colours: of each state (from zero), and of all (logarithmic).

    Outliers do not stretch the colours, where there is anything else: they have the last colour.
    """
    result, known = {}, []
    for state in scene.states:
        lengths = np.linalg.norm(scene.poses.error(state), axis=1)
        usual = lengths[np.isfinite(lengths) & ~scene.poses.outlier]
        known.append(usual if len(usual) else lengths[np.isfinite(lengths)])
        result[state] = [0.0, max(float(known[-1].max()), _EXACT)]
    if known:
        everything = np.concatenate(known)
        high = max(float(everything.max()), _EXACT)
        positive = everything[everything > high * 1e-4]
        low = float(positive.min()) if len(positive) else high
        result["both"] = [low if low < high else high / 10, high]
    return result


def colours() -> NDArray[np.uint8]:
    """Return 256 colours from small to large errors, (256, 4)."""
    from matplotlib import colormaps

    table: NDArray[np.uint8] = np.round(255 * colormaps[_COLOURS](np.linspace(0, 1, 256))).astype(np.uint8)
    return table


def point_radius(scene: Scene) -> float:
    """Return a radius [m] at which points are easy to see and rarely hide each other."""
    from scipy.spatial import cKDTree

    size = float(np.linalg.norm(scene.view.high - scene.view.low))
    points = np.unique(np.round(_places(scene), 6), axis=0)
    if len(points) < 2:
        return _POINT_RADIUS[1] * size
    gaps = cKDTree(points).query(points, k=2)[0][:, 1]
    return float(np.clip(0.42 * np.median(gaps), _POINT_RADIUS[0] * size, _POINT_RADIUS[1] * size))


def _places(scene: Scene) -> FloatArray:
    """Where each point stands: measured, or else as well predicted as known."""
    table = scene.poses
    predicted = np.where(np.isfinite(table.after), table.after, table.before)
    places: FloatArray = np.where(np.isfinite(table.measured), table.measured, predicted)
    return places


def _table(scene: Scene) -> dict[str, Any]:
    table = scene.poses
    group = np.array([GROUPS.index(name) for name in table.group], dtype=np.uint8) + len(GROUPS) * table.outlier.astype(
        np.uint8
    )
    arrays = {
        "joints": table.joints,
        "measured": table.measured,
        "place": _places(scene),
        "before": table.error("before"),
        "after": table.error("after"),
        "sigma": table.sigma,
        "spread": table.spread,
    }
    return {
        "n": len(table),
        "labels": list(table.labels),
        "targets": list(table.targets),
        "group": _encode(group.astype(np.uint8)),
        **{name: _encode(values.astype("<f8")) for name, values in arrays.items()},
    }


def _figure(figure: Figure) -> dict[str, Any]:
    return {
        "placements": figure.placements[:, :3].reshape(-1, 12).tolist(),
        "stretches": figure.stretches[:, :3].reshape(-1, 12).tolist(),
        "width": figure.values.shape[1],
        "values": _encode(figure.values.astype("<f4")),
        "root": None if figure.root is None else figure.root[:3].ravel().tolist(),
    }


def _encode(values: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode()
