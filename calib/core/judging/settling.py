"""Poses of a calibration that settle whether a robot has changed, if they are measured again.

At a pose of the calibration, the model has the same error now as then: so a difference there is a change of the robot.
Poses are chosen one by one: each increases the information on the change most (its determinant, as O1 in
`calib.core.numerics.observability`), with base and targets eliminated, because these are placed anew. Enough poses are
chosen if the change shows with the chance `POWER`.

When it fails. If there are more poses than `MOST`, only some are examined, evenly spread. If the change is smaller than
it was found, it takes more poses.
"""

from __future__ import annotations

import numpy as np

from calib.core.base.arrays import FloatArray, IntArray, evenly_spread
from calib.core.base.errors import CalibrationError
from calib.core.data.pose_groups import pose_labels
from calib.core.judging.acceptance_system import Change, System, candidates
from calib.core.judging.promise import Promise
from calib.core.numerics.identifiability import unit_columns

MOST = 300
"""Largest number of examined poses."""
_COUNTS = (8, 12, 16, 24, 32)  # numbers of poses to measure again
_NOTHING = 1e-6  # information before any pose is chosen, for columns of length 1


def poses_that_settle(promise: Promise, change: Change) -> tuple[str, ...]:
    """Return the names of poses of the calibration that show a found change, best first; none if no poses show it."""
    if not len(promise.joints):
        return ()
    first = np.unique(pose_labels(promise.joints), return_index=True)[1]
    some = np.sort(first)[evenly_spread(len(first), MOST)]
    try:
        order = some[_order(promise, promise.joints[some], change)]
        for count in _COUNTS:
            system = System.planned(promise, promise.joints[order[:count]], same_setup=False)
            shown = {own.name: own.visible for own in system.changes}
            if shown.get(change.name, np.inf) <= abs(change.value) or count >= len(order):
                break
    except CalibrationError:  # poses cannot be simulated, such as those of setups
        return ()
    return tuple(promise.names[k] for k in order[:count])


def _order(promise: Promise, joints: FloatArray, change: Change) -> IntArray:
    system = System.planned(promise, joints, same_setup=False)
    number = [known.name for known in candidates(promise.robot)].index(change.name)
    places, layout = system.rows.jacobian[:, ~system.rows.prior.has], system.rows.layout
    columns = unit_columns(np.column_stack([places, system.candidate_columns[:, number]]))[0]
    visit = layout.visit[layout.reading]
    rows = [columns[visit == k] for k in range(len(joints))]
    information, chosen = _NOTHING * np.eye(columns.shape[1]), list[int]()
    for _ in range(min(_COUNTS[-1], len(rows))):
        inverse = np.linalg.inv(information)
        gain = [np.linalg.slogdet(np.eye(len(own)) + own @ inverse @ own.T)[1] for own in rows]
        gain = [-np.inf if k in chosen else round(float(size), 9) for k, size in enumerate(gain)]
        chosen.append(int(np.argmax(gain)))
        information = information + rows[chosen[-1]].T @ rows[chosen[-1]]
    return np.array(chosen, dtype=np.intp)
