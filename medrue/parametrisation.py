"""The paper's 36 parameters as edits of the joint origins of `urdf/medrue.urdf`; a plugin of `calib`.

Most parameters are one coordinate of one origin, or a difference of two. The exception is the direction of a
five-bar's frame, psi_i = atan2(A_iz - C_iz, A_iy - C_iy), which turns both proximal joints of that five-bar: the
joint offsets sit on top of it, roll = psi_i + dq.

Nominal values are read from the URDF itself, so a calibrated URDF can be calibrated again. An origin is the URDF's own
plus (formula at the values - formula at nominal), so nominal values give back the URDF exactly.

Reference: joubair2015, equations 1-17; urdf/README.md has the tree.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib import DescriptionError, Origin, Parameter, twist_of_edit
from calib.core.numerics import linalg
from medrue.paper_tables import PARAMETERS

FloatArray = NDArray[np.floating[Any]]
LENGTH_SIGMA = 2e-3
"""Expected error of a length: the paper draws them within +-2 mm [m]."""
ANGLE_SIGMA = np.radians(1.5)
"""Expected error of an angle: the paper draws them within +-1.5 deg [rad]."""

_INDEX = {name: index for index, name in enumerate(PARAMETERS)}
_ANGLES = {"dq2", "dq3", "dq4", "dq5", "dq6", "phi_bx", "phi_by", "phi_bz"}
_COORDINATES: dict[str, tuple[tuple[str, int, float], ...]] = {
    # origin: (parameter, coordinate of xyz, factor)
    "base_origin": (("xb", 0, 1), ("yb", 1, 1), ("zb", 2, 1)),
    "q1": (("dq1", 0, 1),),
    "q2": (("d31", 0, -1), ("A1y", 1, 1), ("A1z", 2, 1)),
    "q3": (("d31", 0, -1), ("C1y", 1, 1), ("C1z", 2, 1)),
    "q4": (("d32", 0, 1), ("A2y", 1, 1), ("A2z", 2, 1)),
    "q5": (("d32", 0, 1), ("C2y", 1, 1), ("C2z", 2, 1)),
    "B1": (("L11", 1, 1),),
    "E1_B_origin": (("L12", 1, 1),),
    "D1": (("L13", 1, 1),),
    "E1_D_origin": (("L14", 1, 1),),
    "B2": (("L21", 1, 1),),
    "E2_B_origin": (("L22", 1, 1),),
    "D2": (("L23", 1, 1),),
    "E2_D_origin": (("L24", 1, 1),),
    "G2_E_origin": (("d42", 0, 1), ("d32", 0, -1)),
    "q6": (),
    "beta": (("d31", 0, 1), ("d41", 0, -1)),
    "slide": (("d41", 0, 1), ("d42", 0, 1)),
    "F6_origin": (("d41", 0, 1), ("d5", 0, 1)),
    "tool_origin": (("xt", 0, 1), ("yt", 1, 1), ("zt", 2, 1)),
}
_TURNING: dict[str, tuple[str, ...]] = {
    # origin: parameters that are added to roll, pitch and yaw
    "base_origin": ("phi_bx", "phi_by", "phi_bz"),
    **{f"q{k}": (f"dq{k}",) for k in range(2, 7)},
}
_ANCHORS = {k: [_INDEX[f"{point}{k}{axis}"] for point in "AC" for axis in "yz"] for k in (1, 2)}
"""Indices of the parameters Ay, Az, Cy and Cz of each five-bar."""
_FIVE_BARS = {"q2": 1, "q3": 1, "q4": 2, "q5": 2}
"""Five-bar whose frame decides the roll of an origin, by the name of the origin."""


@dataclass(frozen=True, eq=False)
class MedrueParametrisation:
    """Parametrisation of MedRUE in the sense of `calib.Parametrisation`.

    Args:
        origins: Nominal joint origins of the URDF, by joint name.

    Raises:
        DescriptionError: The URDF is not a MedRUE: a joint is missing, or no parameters give one of its origins.
    """

    origins: Mapping[str, Origin]
    parameters: tuple[Parameter, ...] = field(init=False)

    def __post_init__(self) -> None:
        missing = [name for name in _COORDINATES if name not in self.origins]
        if missing:
            raise DescriptionError(f"parametrisation 'medrue': the URDF has no joint '{missing[0]}'")
        nominal = _read_parameters(self.origins)
        object.__setattr__(
            self,
            "parameters",
            tuple(
                Parameter(
                    name,
                    "angle" if name in _ANGLES else "length",
                    float(value),
                    float(ANGLE_SIGMA) if name in _ANGLES else LENGTH_SIGMA,
                    "deg" if name in _ANGLES else "mm",
                    prior=False,
                )
                for name, value in zip(PARAMETERS, nominal, strict=True)
            ),
        )
        for name, xyz, rpy in zip(_COORDINATES, _xyz(nominal), _rpy(nominal), strict=True):
            if not (
                np.allclose(xyz, self.origins[name].xyz, rtol=0, atol=1e-12)
                and np.allclose(rpy, self.origins[name].rpy, rtol=0, atol=1e-12)
            ):
                raise DescriptionError(
                    f"parametrisation 'medrue': the paper's 36 parameters cannot describe the origin of joint '{name}'"
                )

    def placements(self, values: FloatArray) -> dict[str, pin.SE3]:
        """Return the origins at `values`, (36,) [m, rad], by joint name."""
        rotations = {name: pin.rpy.rpyToMatrix(*rpy) for name, rpy in self._turning(values).items()}
        moved = self._urdf_origins[0] + (_xyz(values) - self._nominal[0])
        return {
            name: pin.SE3(rotations.get(name, rotation), xyz)
            for (name, (rotation, _)), xyz in zip(self._turned_origins.items(), moved, strict=True)
        }

    def twists(self, values: FloatArray) -> dict[str, FloatArray]:
        """Return the twist of each origin per parameter, (6, 36), by joint name."""
        turning = {
            name: twist_of_edit(rpy, _LINEAR[name][0], _rpy_derivative(name, values))
            for name, rpy in self._turning(values).items()
        }
        return {name: turning.get(name, twist) for name, (_, twist) in self._turned_origins.items()}

    @cached_property
    def _nominal(self) -> tuple[FloatArray, FloatArray]:
        """Xyz and rpy of all origins from the nominal parameters, (n_origins, 3)."""
        nominal = np.array([parameter.nominal_si for parameter in self.parameters])
        return _xyz(nominal), _rpy(nominal)

    @cached_property
    def _urdf_origins(self) -> tuple[FloatArray, FloatArray]:
        """Xyz and rpy of all origins in the URDF, (n_origins, 3)."""
        given = [self.origins[name] for name in _COORDINATES]
        return np.array([origin.xyz for origin in given]), np.array([origin.rpy for origin in given])

    @cached_property
    def _turned_origins(self) -> dict[str, tuple[FloatArray, FloatArray]]:
        """Rotation matrix and twists of each origin in the URDF, which no parameter changes where it does not turn."""
        return {
            name: (pin.rpy.rpyToMatrix(*self.origins[name].rpy), twist_of_edit(self.origins[name].rpy, *_LINEAR[name]))
            for name in _COORDINATES
        }

    def _turning(self, values: FloatArray) -> dict[str, FloatArray]:
        """Rpy of the origins that turn."""
        rpy = self._urdf_origins[1] + (_rpy(values) - self._nominal[1])
        return {name: own for name, own in zip(_COORDINATES, rpy, strict=True) if name in _TURNING}


def _linear(name: str) -> tuple[FloatArray, FloatArray]:
    """d(xyz)/d(parameters) and d(rpy)/d(parameters) without the direction of a five-bar, (3, 36) each."""
    d_xyz, d_rpy = np.zeros((3, len(PARAMETERS))), np.zeros((3, len(PARAMETERS)))
    for parameter, coordinate, factor in _COORDINATES[name]:
        d_xyz[coordinate, _INDEX[parameter]] += factor
    for row, angle in enumerate(_TURNING.get(name, ())):
        d_rpy[row, _INDEX[angle]] = 1.0
    return d_xyz, d_rpy


_LINEAR = {name: _linear(name) for name in _COORDINATES}


_ALL_XYZ, _ALL_RPY = (np.array([_LINEAR[name][part] for name in _COORDINATES]) for part in (0, 1))
_ROLLS = [(k, _FIVE_BARS[name]) for k, name in enumerate(_COORDINATES) if name in _FIVE_BARS]


def _xyz(values: FloatArray) -> FloatArray:
    """Xyz of all origins from the paper's parameters, (n_origins, 3) [m]."""
    return np.asarray(_ALL_XYZ @ values)


def _rpy(values: FloatArray) -> FloatArray:
    """Rpy of all origins from the paper's parameters, (n_origins, 3) [rad]."""
    rpy: FloatArray = _ALL_RPY @ values
    directions = {five_bar: _direction(values, five_bar) for five_bar in (1, 2)}
    for place, five_bar in _ROLLS:
        rpy[place, 0] += directions[five_bar]
    return rpy


def _rpy_derivative(name: str, values: FloatArray) -> FloatArray:
    """d(rpy)/d(parameters), (3, 36)."""
    d_rpy = _LINEAR[name][1].copy()
    if name in _FIVE_BARS:
        five_bar = _FIVE_BARS[name]
        y, z = _anchor_vector(values, five_bar)
        squared = y * y + z * z
        d_rpy[0, _ANCHORS[five_bar]] = -z / squared, y / squared, z / squared, -y / squared
    return d_rpy


def _anchor_vector(values: FloatArray, five_bar: int) -> tuple[float, float]:
    """C_i -> A_i in the y-z plane [m]."""
    a_y, a_z, c_y, c_z = values[_ANCHORS[five_bar]].tolist()
    return a_y - c_y, a_z - c_z


def _direction(values: FloatArray, five_bar: int) -> float:
    """psi_i, the direction C_i -> A_i from y towards z [rad]."""
    y, z = _anchor_vector(values, five_bar)
    return float(np.arctan2(z, y))


def _read_parameters(origins: Mapping[str, Origin]) -> FloatArray:
    """Invert `_xyz` and `_rpy`: the 36 values that a URDF's origins stand for."""
    xyz, rpy = (np.array([getattr(origins[name], part) for name in _COORDINATES]) for part in ("xyz", "rpy"))
    n = len(PARAMETERS)
    lengths = linalg.lstsq(_ALL_XYZ.reshape(-1, n), xyz.ravel())
    angles = linalg.lstsq(_ALL_RPY.reshape(-1, n), (rpy - _rpy(lengths)).ravel())
    # the last digit is open: 1e-15 m is far below any drawing
    return np.round(lengths + angles, 15) + 0.0  # no negative zeros
