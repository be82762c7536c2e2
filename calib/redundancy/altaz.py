"""Telescope and antenna mounts: their pointing errors in the names of the trade.

Joints `azimuth` (about -z, as compasses count), `altitude` (about -y) and the fixed `collimation`, whose x axis is the
target's line of sight; x to the north, z up. With the readings of the encoders minus the truth,

    dA = -IA - CA sec E - NPAE tan E - AN sin A tan E - AW cos A tan E
    dE =  IE - AN cos A + AW sin A - TF cos E

IA, IE: index errors; CA: collimation; NPAE: non-perpendicularity of the axes; AN, AW: tilt of the azimuth axis to north
and west. TF, flexure of the tube, is the joint term `tube_flexure` of the altitude.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.parameter import Parameter
from calib.core.robots.parameters import Origin
from calib.core.robots.terms.term import Context, Joint, JointTerm, TermSection
from calib.redundancy.named_origins import NamedComponent, NamedOrigins

_UNIT = "arcsec"
COMPONENTS = (
    NamedComponent("IA", "azimuth", "rz", -1, 0.1, _UNIT),
    NamedComponent("AN", "azimuth", "ry", -1, 0.01, _UNIT),
    NamedComponent("AW", "azimuth", "rx", 1, 0.01, _UNIT),
    NamedComponent("IE", "altitude", "ry", 1, 0.1, _UNIT),
    NamedComponent("NPAE", "altitude", "rx", 1, 0.01, _UNIT),
    NamedComponent("CA", "collimation", "rz", -1, 0.01, _UNIT),
)


def altaz(origins: Mapping[str, Origin]) -> NamedOrigins:
    """Return the parametrisation of a mount."""
    return NamedOrigins(COMPONENTS, origins)


@dataclass(frozen=True)
class TubeFlexure(JointTerm):
    """TF: the tube sags, and points at E + TF cos E (TF < 0) at a reading E of the altitude's encoder."""

    cause = "load (compliance)"
    in_auto = False
    joint: str
    parameters: tuple[Parameter, ...]

    @classmethod
    def from_section(cls, joint: Joint, section: TermSection, sigma: float | None) -> TubeFlexure:
        """Return the term of an entry in a robot description."""
        return cls(joint.name, (Parameter("TF", joint.dimension, 0.0, sigma or 1e-3, _UNIT),))

    def columns(self, q: FloatArray, j: int, context: Context) -> FloatArray:
        """Return cos E, (n, 1)."""
        return np.cos(q[:, [j]])
