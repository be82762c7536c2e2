"""The paper's 36 parameters as edits of the joint origins of `urdf/medrue.urdf`; a plugin of `calib`.

Most parameters are one coordinate of one origin, or a difference of two. The exception is the direction of a
five-bar's frame, psi_i = atan2(A_iz - C_iz, A_iy - C_iy), which turns both proximal joints of that five-bar: the
joint offsets sit on top of it, roll = psi_i + dq.

Nominal values are read from the URDF itself, so a calibrated URDF can be calibrated again. An origin is the URDF's own
plus (formula at the values - formula at nominal), so nominal values give back the URDF exactly.

Reference: Joubair, Zhao, Bigras and Bonev 2015, equations 1-17; urdf/README.md has the tree.
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
_ROLLS: dict[str, tuple[str, int | None]] = {  # origin: (joint offset, five-bar)
    "q2": ("dq2", 1),
    "q3": ("dq3", 1),
    "q4": ("dq4", 2),
    "q5": ("dq5", 2),
    "q6": ("dq6", None),
}


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
        for name in _COORDINATES:
            xyz, rpy = _formula(name, nominal)
            if not (
                np.allclose(xyz, self.origins[name].xyz, rtol=0, atol=1e-12)
                and np.allclose(rpy, self.origins[name].rpy, rtol=0, atol=1e-12)
            ):
                raise DescriptionError(
                    f"parametrisation 'medrue': the paper's 36 parameters cannot describe the origin of joint '{name}'"
                )

    def placements(self, values: FloatArray) -> dict[str, pin.SE3]:
        """Return the origins at `values`, (36,) [m, rad], by joint name."""
        result = {}
        for name in _COORDINATES:
            xyz, rpy = self._edited(name, values)
            result[name] = pin.SE3(pin.rpy.rpyToMatrix(*rpy), xyz)
        return result

    def twists(self, values: FloatArray) -> dict[str, FloatArray]:
        """Return the twist of each origin per parameter, (6, 36), by joint name."""
        return {
            name: twist_of_edit(self._edited(name, values)[1], *_formula_derivative(name, values))
            for name in _COORDINATES
        }

    @cached_property
    def _nominal(self) -> dict[str, tuple[FloatArray, FloatArray]]:
        """Xyz and rpy of each origin from the nominal parameters."""
        nominal = np.array([parameter.nominal_si for parameter in self.parameters])
        return {name: _formula(name, nominal) for name in _COORDINATES}

    def _edited(self, name: str, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        xyz, rpy = _formula(name, values)
        xyz_nominal, rpy_nominal = self._nominal[name]
        return self.origins[name].xyz + (xyz - xyz_nominal), self.origins[name].rpy + (rpy - rpy_nominal)


def _formula(name: str, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The origin's xyz [m] and rpy [rad] from the paper's parameters."""
    xyz, rpy = np.zeros(3), np.zeros(3)
    for parameter, coordinate, factor in _COORDINATES.get(name, ()):
        xyz[coordinate] += factor * values[_INDEX[parameter]]
    if name in _ROLLS:
        offset, five_bar = _ROLLS[name]
        rpy[0] = values[_INDEX[offset]] + (_direction(values, five_bar) if five_bar else 0.0)
    elif name == "base_origin":
        rpy = np.array([values[_INDEX[angle]] for angle in ("phi_bx", "phi_by", "phi_bz")])
    return xyz, rpy


def _formula_derivative(name: str, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """d(xyz)/d(parameters) and d(rpy)/d(parameters), (3, 36) each."""
    d_xyz, d_rpy = np.zeros((3, len(PARAMETERS))), np.zeros((3, len(PARAMETERS)))
    for parameter, coordinate, factor in _COORDINATES[name]:
        d_xyz[coordinate, _INDEX[parameter]] += factor
    if name in _ROLLS:
        offset, five_bar = _ROLLS[name]
        d_rpy[0, _INDEX[offset]] = 1.0
        if five_bar:
            y, z = _anchor_vector(values, five_bar)
            squared = y * y + z * z
            for point, sign in (("A", 1.0), ("C", -1.0)):
                d_rpy[0, _INDEX[f"{point}{five_bar}y"]] = -sign * z / squared
                d_rpy[0, _INDEX[f"{point}{five_bar}z"]] = sign * y / squared
    elif name == "base_origin":
        for row, angle in enumerate(("phi_bx", "phi_by", "phi_bz")):
            d_rpy[row, _INDEX[angle]] = 1.0
    return d_xyz, d_rpy


def _anchor_vector(values: FloatArray, five_bar: int) -> tuple[float, float]:
    """C_i -> A_i in the y-z plane [m]."""
    a_y, a_z, c_y, c_z = (values[_INDEX[f"{point}{five_bar}{axis}"]] for point in "AC" for axis in "yz")
    return a_y - c_y, a_z - c_z


def _direction(values: FloatArray, five_bar: int) -> float:
    """psi_i, the direction C_i -> A_i from y towards z [rad]."""
    y, z = _anchor_vector(values, five_bar)
    return float(np.arctan2(z, y))


def _read_parameters(origins: Mapping[str, Origin]) -> FloatArray:
    """Invert `_formula`: the 36 values that a URDF's origins stand for."""
    values = np.zeros(len(PARAMETERS))

    def put(parameter: str, value: float) -> None:
        values[_INDEX[parameter]] = value

    for name, places in _COORDINATES.items():
        if len(places) != len({coordinate for _, coordinate, _ in places}):
            continue  # a difference or sum of two parameters: below
        for parameter, coordinate, factor in places:
            put(parameter, factor * origins[name].xyz[coordinate])
    put("d41", values[_INDEX["d31"]] - origins["beta"].xyz[0])
    put("d42", origins["slide"].xyz[0] - values[_INDEX["d41"]])
    put("d5", origins["F6_origin"].xyz[0] - values[_INDEX["d41"]])
    for row, angle in enumerate(("phi_bx", "phi_by", "phi_bz")):
        put(angle, origins["base_origin"].rpy[row])
    for name, (offset, five_bar) in _ROLLS.items():
        put(offset, origins[name].rpy[0] - (_direction(values, five_bar) if five_bar else 0.0))
    # differences such as 0.1668 - 0.1253 leave the last digit open: 1e-15 m is far below any drawing
    return np.round(values, 15) + 0.0  # no negative zeros
