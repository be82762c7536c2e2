"""The home configuration: does it close, is it regular, and which assembly mode is it in?"""

from __future__ import annotations

import numpy as np

from calib.arrays import FloatArray
from calib.errors import DescriptionError
from calib.model.closure import AssemblyMode, block_signs, blocks, gap_text, open_by, residual, scaled, singular_values
from calib.model.continuation import closing_tolerance, newton
from calib.model.mechanism import Mechanism
from calib.units import millimetres

_OPEN_HOME = 0.05  # characteristic lengths, or rad: as much as a calibrated URDF differs from its drawing


def closed_home(mechanism: Mechanism, home: dict[str, float], singularity_limit: float, where: str) -> AssemblyMode:
    """Check that the home configuration closes, polish it, and record its assembly mode.

    Args:
        mechanism: The robot.
        home: Joint values by name [m or rad]; names that are missing count as 0 where there are no loops.
        singularity_limit: Smallest acceptable singular value of the scaled C_p at home.
        where: The description, for messages.

    Raises:
        DescriptionError: Home does not close, or is singular.
    """
    actuated = np.array([[home.get(name, 0.0) for name in mechanism.driven]])
    passive = np.array([[home.get(name, 0.0) for name in mechanism.passive]])
    if not mechanism.loops:
        return AssemblyMode(mechanism, actuated[0], passive[0], (), (), np.ones(0))
    missing = [name for name in mechanism.actuated + mechanism.passive if name not in home]
    if missing:
        raise DescriptionError(
            f"{where}: home: gives no value for joint '{missing[0]}'; a robot with loops needs an"
            " assembled configuration of every joint"
        )
    values, slope, _ = residual(mechanism, actuated, passive)
    _check_closed(mechanism, values, where)
    _check_regular(mechanism, slope, singularity_limit, where)
    rows, columns = blocks(np.abs(scaled(mechanism, slope)[0]) > 1e-9)
    mode = AssemblyMode(mechanism, actuated[0], passive[0], rows, columns, block_signs(slope, rows, columns)[0])
    polished, _, _, ok = newton(mechanism, mode, actuated, passive)
    if not ok[0]:
        raise DescriptionError(
            f"{where}: home: cannot be closed to {closing_tolerance(mechanism):.2g} m from the values given"
        )
    return AssemblyMode(mechanism, actuated[0], polished[0], rows, columns, mode.signs)


def _check_closed(mechanism: Mechanism, values: FloatArray, where: str) -> None:
    lengths, angles = (gaps[0] for gaps in open_by(mechanism, values))
    limit = _OPEN_HOME * mechanism.length
    excess = np.maximum(lengths / limit, angles / _OPEN_HOME)
    loop = int(np.argmax(excess))
    if excess[loop] > 1:
        turned = f" and {np.degrees(_OPEN_HOME):.0f} deg" if angles[loop] > 0 else ""
        raise DescriptionError(
            f"{where}: home: loop {mechanism.loops[loop].name} is open by {gap_text(lengths[loop], angles[loop])};"
            f" give joint values at which the robot is assembled (to {millimetres(limit):.0f} mm{turned} or better)"
        )


def _check_regular(mechanism: Mechanism, slope: FloatArray, limit: float, where: str) -> None:
    smallest = float(singular_values(mechanism, slope)[0])
    if smallest < limit:
        loose = [mechanism.loops[i].name for i in _loose_loops(mechanism, slope[0])]
        raise DescriptionError(
            f"{where}: home: the closures do not hold the passive joints (smallest singular value {smallest:.2g} of the"
            f" scaled passive Jacobian, limit {limit:g}; look at {', '.join(loose)}): home is singular, or"
            " closed_loop_axes names a direction that the mechanism does not constrain"
        )


def _loose_loops(mechanism: Mechanism, slope: FloatArray) -> list[int]:
    """Loops whose rows make up the direction in which the closures hold nothing."""
    left = np.linalg.svd(scaled(mechanism, slope[None])[0])[0][:, -1]
    lengths, angles = open_by(mechanism, left[None])
    return [int(i) for i in np.flatnonzero(np.hypot(lengths, angles)[0] > 0.3)]
