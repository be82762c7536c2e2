"""Changes of base and tool that no pose of a robot shows, such as a shift of both along the parallel axes of a SCARA.

With J the derivative of poses over the joints' ranges by parameters in sigmas, of places (p) and of joint origins (o),
and unit rows as the priors of joint origins, the places are seen by what origins cannot imitate:

    K = B - A A^+ B        A = [J_o; 1]        B = [J_p; 0]

A singular direction of K with a standard deviation above a metre or a radian is not seen. So axes that are parallel but
for errors of the robot, or for the digits of its file, count as parallel.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.core.base.arrays import FloatArray, IntArray
from calib.core.instruments.hand_eye import LEVER
from calib.core.numerics import linalg
from calib.core.numerics.identifiability import eliminate, reduce_rows
from calib.core.robots.jacobian import linearise
from calib.core.robots.robot import Robot
from calib.matching.agreement import other_poses
from calib.shared.null_space import UnseenGroup, natural_coefficients, null_groups

_SMALL = 1e-5  # change of a position that poses show [m]
_UNSEEN = 100.0  # least standard deviation of an unseen change, in sigmas of places: 1 m, 1 rad
_NAMED = 1e-3  # components of such a change that are smaller than this part of its largest one are not named


def without_unseen(model: Robot) -> Robot:
    """Return the robot with as many parameters of places held as changes of them are not seen."""
    places = _free_places(model)
    held = eliminate(_seen_changes(model, places)).dropped
    return model.fix([model.parameters[places[k]].name for k in held])


def unseen_changes(model: Robot) -> list[str]:
    """Return the changes of free places that are not seen, in words: `tool.z +1 mm, base.z -1 mm`."""
    places, tool = _free_places(model), f"{model.target_names[0]}."
    parameters = [model.parameters[k] for k in places]
    of_tool = [k for k, p in enumerate(parameters) if p.name.startswith(tool)]
    for k in of_tool:
        parameters[k] = replace(parameters[k], name=parameters[k].name.replace(tool, "tool.", 1))
    groups = map(_without_small, null_groups(_seen_changes(model, places), of_tool))
    return [
        ", ".join(f"{name} {size:+.4g} {unit}" for name, size, unit in natural_coefficients(group, parameters))
        for group in groups
    ]


def _free_places(model: Robot) -> IntArray:
    """Indices of the free parameters of base and tool."""
    return np.flatnonzero(model.is_free & np.array([p.placement for p in model.parameters]))


def _seen_changes(model: Robot, places: IntArray) -> FloatArray:
    """Changes of places that are seen, orthonormal rows in sigmas, (k, n_places)."""
    origins = np.setdiff1d(np.flatnonzero(model.is_free), places)
    rows = linearise(model, model.assemble(other_poses(model)), turns=True).jacobian[:, 0]
    rows = rows * [p.sigma_si for p in model.parameters] / np.repeat([_SMALL, _SMALL / LEVER], 3)[:, None]
    rows = reduce_rows(rows.reshape(-1, rows.shape[-1]))
    by_origins = np.vstack([rows[:, origins], np.eye(len(origins))])
    by_places = np.vstack([rows[:, places], np.zeros((len(origins), len(places)))])
    left = by_places - by_origins @ linalg.lstsq(by_origins, by_places)
    _, values, directions = linalg.svd(left, full_matrices=False)
    return np.asarray(directions[values > 1.0 / _UNSEEN])


def _without_small(group: UnseenGroup) -> UnseenGroup:
    """The group without components that are rounding, or too small to matter."""
    large = np.abs(group.coefficients) > _NAMED * np.max(np.abs(group.coefficients))
    return UnseenGroup(tuple(np.array(group.members)[large].tolist()), group.coefficients[large])
