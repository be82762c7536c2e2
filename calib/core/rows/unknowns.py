"""Unknowns: the parameters that may change, their scales and their priors."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays
from calib.core.base.parameter import Parameter
from calib.core.numerics.prior import Prior
from calib.core.robots.robot import Robot

_ROUNDING = 1e-14  # a parameter that moves by less stays nominal, to the last digit [m or rad]


@dataclass(frozen=True, eq=False)
class Unknowns(ReadOnlyArrays):
    """Parameters that may change, and their scales.

    Attributes:
        index: Indices among all parameters, (n,).
        scales: Sigma of each, (n,) [SI].
        expected: Means of the priors: nominal values, or those of a fleet, (n,) [SI].
        placement: Whether each is only a place of an instrument or a target, (n,).
        family: Number of the family of each, -1 for none, (n,).
    """

    names: tuple[str, ...]
    index: IntArray
    scales: FloatArray
    expected: FloatArray
    prior: Prior
    placement: BoolArray
    family: IntArray
    families: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.names)

    def has(self, others: Unknowns) -> bool:
        """Return whether these include all of `others`."""
        return others.index is self.index or set(others.index.tolist()) <= set(self.index.tolist())

    @staticmethod
    def from_robot(robot: Robot, free: BoolArray | None = None) -> Unknowns:
        """Return chosen parameters of a robot, by a mask (n_parameters,): its free ones if not given."""
        chosen = robot.is_free if free is None else free
        kept = [parameter for parameter, use in zip(robot.parameters, chosen, strict=True) if use]
        families = tuple(dict.fromkeys(p.family for p in kept if p.family))
        return Unknowns(
            tuple(p.name for p in kept),
            np.flatnonzero(chosen),
            robot.parameters.sigma_si[chosen],
            robot.parameters.expected_si[chosen],
            _prior(robot, kept),
            np.array([p.placement for p in kept], dtype=bool),
            np.array([families.index(p.family) if p.family else -1 for p in kept], dtype=np.intp),
            families,
        )

    def select(self, chosen: BoolArray) -> Unknowns:
        """Return the unknowns that a mask (n,) chooses."""
        return Unknowns(
            tuple(name for name, use in zip(self.names, chosen, strict=True) if use),
            self.index[chosen],
            self.scales[chosen],
            self.expected[chosen],
            self.prior.select(chosen),
            self.placement[chosen],
            self.family[chosen],
            self.families,
        )

    def rescale_families(self, factors: FloatArray) -> Unknowns:
        """Return the unknowns with the sigma of each family multiplied by its factor, (n_families,)."""
        factor = np.append(factors, 1.0)[self.family]  # the appended entry is for family -1
        return replace(self, scales=self.scales * factor)

    @staticmethod
    def chosen_by_poses(robot: Robot) -> Unknowns:
        """Return the free parameters that chosen poses should determine: all but families, which priors hold."""
        unknowns = Unknowns.from_robot(robot)
        return unknowns.select(unknowns.family < 0)

    def deviations(self, values: FloatArray) -> FloatArray:
        """Return u = (p - p_expected) / s from the values of all parameters, (n_parameters,)."""
        return (values[self.index] - self.expected) / self.scales

    def robot_at(self, robot: Robot, u: FloatArray) -> Robot:
        """Return a robot with these parameters at p = p_expected + s u, u (n,)."""
        values = robot.values.copy()
        values[self.index] = self.values_at(u)
        return robot.with_parameters(values)

    def values_at(self, u: FloatArray) -> FloatArray:
        """Return p = p_expected + s u, (..., n) [SI], of u (..., n)."""
        change = self.scales * u
        return np.asarray(self.expected + np.where(np.abs(change) < _ROUNDING, 0.0, change))


def _prior(robot: Robot, kept: list[Parameter]) -> Prior:
    has, fleet = np.array([p.prior for p in kept], dtype=bool), robot.description.fleet
    together = [k for k, p in enumerate(kept) if fleet is not None and fleet.knows(p.name)]
    if fleet is None or not together:
        return Prior(has)
    correlations = fleet.correlations([kept[k].name for k in together])
    return Prior(has, np.array(together, dtype=np.intp), correlations)
