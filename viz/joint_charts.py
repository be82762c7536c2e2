"""Plots of joints: joint errors by fitted terms and by readings, and offsets as dials."""

from __future__ import annotations

import numpy as np

from calib import Fit
from calib.core.base.arrays import FloatArray
from calib.core.base.parameter import Parameter
from calib.core.base.units import from_unit, in_unit, quantity_text
from calib.core.robots.joint_errors import actual_joints, term_columns
from calib.core.rows.observed import observe
from viz.charts import COLOURS, Chart, axis, layer, panel
from viz.scene import ViewerJoint

_SEEN = 0.04  # readings of a pose count for a joint if its squared reach is more than this part of the best pose's
_FURTHEST = np.radians(50.0)  # rotation of the needle for the largest offset


def corrections(fit: Fit, joints: tuple[ViewerJoint, ...]) -> Chart | None:
    """Return joint errors by fitted terms and by readings; None without terms.

    With the residuals r of a pose and the column J_j of joint j, the readings show an error of the joint that is larger
    than the fitted error by -(J_j^T r) / (J_j^T J_j).
    """
    if not fit.robot.terms:
        return None
    data = fit.identification.data
    added = actual_joints(fit.robot, data.joints, term_columns(fit.robot, data.joints, data.conditions))
    added, more = added[:, : len(joints)] - data.joints, _left_in_joints(fit)
    panels = []
    for k, joint in enumerate(joints):
        if not np.any(added[:, k]):
            continue
        order = np.argsort(data.joints[:, k], kind="stable")
        values, change = joint.per_si * data.joints[order, k], joint.per_si * added[order, k]
        shown = change + joint.per_si * more[order, k]
        names = [data.names[place] for place in order]
        texts = [f"pose {name}: fitted {by:+.4f} {joint.unit}" for name, by in zip(names, change, strict=True)]
        seen = [f"pose {name}: readings show {by:+.4f} {joint.unit}" for name, by in zip(names, shown, strict=True)]
        own = all(term.follows_command and not term.depends_on for term in fit.robot.terms if term.joint == joint.name)
        layers = [
            layer("points", "shown by readings", COLOURS["before"], x=values, y=shown, texts=seen),
            layer("line", "fitted", COLOURS["after"], x=values, y=change)
            if own
            else layer("points", "fitted", COLOURS["after"], x=values, y=change, texts=texts),
        ]
        panels.append(
            panel(axis(f"{joint.name} [{joint.unit}]"), axis(f"joint error [{joint.unit}]"), layers, height=240)
        )
    text = "Error of each joint: the curve is the fitted terms, each point the error that the readings of a pose show."
    return Chart("joint-errors", "Fitted errors of the joints", text, tuple(panels), 280) if panels else None


def _left_in_joints(fit: Fit) -> FloatArray:
    """Joint error in the residuals of each pose, (n_visits, n_actuated) [SI]; NaN if they depend too little on it."""
    errors = fit.identification
    data, conditions = errors.data, errors.data.conditions
    at = fit.robot.assemble(data.joints, errors.passive, data.labels, conditions)
    observed = observe(fit.robot, at, data.readings, joints=True)
    along, reach = np.zeros((2, *data.joints.shape))
    for instrument, part, rows in errors.parts():
        if part.name == errors.main_part.name:
            block, visits = observed[instrument.name], data.readings[instrument.name].visits
            J, r = block.joint_derivative[:, rows], block.residuals[:, rows]
            J = np.where(np.isfinite(r)[:, :, None], J, 0.0)
            np.add.at(along, visits, np.einsum("nrk,nr->nk", J, np.nan_to_num(r)))
            np.add.at(reach, visits, np.sum(J**2, axis=1))
    enough = reach > _SEEN * reach.max(axis=0, initial=0.0)
    return np.where(enough, -along / np.where(enough, reach, 1.0), np.nan)


def dials(fit: Fit) -> Chart | None:
    """Return the offset of each revolute joint: the change of the parameter that turns it about its own axis."""
    nominal = fit.nominal
    own = nominal.values[: len(nominal.parametrisation.parameters)]
    twists, axes = nominal.parametrisation.twists(own), {one.name: one for one in nominal.urdf.joints}
    offsets = []
    for name, twist in twists.items():
        joint = axes.get(name)
        if joint is None or joint.type not in ("revolute", "continuous"):
            continue
        about = np.array(joint.axis) / np.linalg.norm(joint.axis)
        along = np.concatenate([np.zeros(3), about])
        for k, parameter in enumerate(nominal.parametrisation.parameters):
            column = twist[:, k]
            turns = np.allclose(column, along * (along @ column), atol=1e-9) and abs(along @ column) > 0.5
            if turns and parameter.dimension == "angle" and parameter.name in fit.free_names:
                found = fit.parameters[parameter.name]
                if found.status != "prior" and np.isfinite(found.high95):  # the measurements determine it
                    change, half = found.value - found.nominal, found.high95 - found.value
                    change, half = (from_unit(value, parameter.unit) for value in (change, half))
                    offsets.append((parameter, change, half))
    if not offsets:
        return None
    turn = _FURTHEST / max(1e-12, *(max(abs(value), half) for _, value, half in offsets))
    panels = tuple(_dial(parameter, value, half, turn) for parameter, value, half in offsets)
    text = (
        f"Straight up is nominal, plus is to the left; the needle is enlarged {turn:.0f} times, with its 95 %"
        " interval. Not to be typed in: these offsets belong to the whole model, and calib export writes those for a"
        ' controller. Offsets of status "prior" or "held" have no dial.'
    )
    return Chart("dials", "Joint offsets", text, panels, 150)


def _dial(parameter: Parameter, value: float, half: float, turn: float) -> dict[str, object]:
    """An offset [rad]: a circle, its needle, and the interval as an arc inside the circle."""
    circle, needle = np.linspace(0, 2 * np.pi, 61), turn * value
    low, high = np.clip([turn * (value - half), turn * (value + half)], -np.pi, np.pi)
    arc = np.linspace(low, high, 31)
    name, unit = parameter.name, parameter.unit
    says = f"{name}: {in_unit(value, unit):+.4f} ± {quantity_text(half, unit, '.2g')}"
    layers = [
        layer("line", x=np.sin(circle), y=np.cos(circle)),
        layer("line", x=[0.0, 0.0], y=[0.9, 1.1]),
        layer("line", "", COLOURS["after"], x=-0.85 * np.sin(arc), y=0.85 * np.cos(arc)),
        layer("line", "", COLOURS["after"], x=[0.0, -np.sin(needle)], y=[0.0, np.cos(needle)]),
        layer("points", "", COLOURS["after"], x=[-np.sin(needle)], y=[np.cos(needle)], texts=[says]),
    ]
    around = axis("")
    title = f"{name}\n{quantity_text(value, unit, '+.3f')}"
    return dict(panel(around, around, layers, title=title, height=170, equal=True, bare=True))
