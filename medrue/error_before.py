"""The error before calibration, ours and the paper's: attempts to explain the difference.

    python -m medrue.error_before

The paper prints the mean error of the nominal robot for the robot of its simulation (Table I's actual parameters,
Table II) and for the real one (Table III's identified parameters, Table IV). At our poses the same parameters give
larger errors. This module computes by the closed form, without noise and imperfections, the errors that follow from
other readings of the text and from other poses:

* the base placed by a best fit beforehand;
* deviations of whole groups of parameters with the opposite sign;
* the base's rotation composed in another order, or the other way round;
* other places of the half cylinder, other working modes, the probe turned the other way, straight or leaning.

A reading explains the paper's figures only if it gives those of both tables at once.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.units import millimetres
from calib.core.numerics.rigid import best_transform
from medrue.closed_form import base_in_world, forward, homogeneous, name_parameters, rotation_x, rotation_y, rotation_z
from medrue.closed_form_inverse import WorkingMode, inverse
from medrue.paper_tables import (
    ANCHORS,
    BASE_IN_WORLD,
    JOINT_OFFSETS,
    LENGTHS,
    PARAMETERS,
    TOOL_POINT,
    error_table,
    table1,
    table3,
)
from medrue.workspace import LEAN_AT_END, RADIUS, TWIST_SPREAD, target_workspace

GROUPS = (
    BASE_IN_WORLD[:3],
    BASE_IN_WORLD[3:],
    TOOL_POINT,
    JOINT_OFFSETS[:1],
    JOINT_OFFSETS[1:5],
    JOINT_OFFSETS[5:],
    LENGTHS,
    (*ANCHORS, "d42"),
)
"""Parameters that one convention would reverse together."""
ELBOWS = ((1, -1), (1, 1), (-1, -1), (-1, 1))
NEAR = 0.1
"""A figure counts as the paper's if the relative difference is at most this."""


@dataclass(frozen=True)
class DistanceSummary:
    """Distances between the nominal and the true robot over some poses, [mm]."""

    smallest: float
    mean: float
    largest: float
    std: float

    def __str__(self) -> str:
        """The mean and the range."""
        return f"{self.mean:.2f} mm on average, {self.smallest:.2f} to {self.largest:.2f} mm"

    def is_near(self, printed: Mapping[str, float]) -> bool:
        """Whether mean, largest and std are the paper's within `NEAR`."""
        pairs = ((self.mean, printed["mean"]), (self.largest, printed["max"]), (self.std, printed["std"]))
        return all(abs(ours / theirs - 1) < NEAR for ours, theirs in pairs)


def errors_of(differences: FloatArray) -> DistanceSummary:
    """Summarise differences of positions, (n, 3) [m]."""
    distances = millimetres(np.linalg.norm(differences, axis=1))
    return DistanceSummary(
        *(float(f) for f in (distances.min(), distances.mean(), distances.max(), distances.std(ddof=1)))
    )


def differences(parameters: FloatArray, q: FloatArray) -> FloatArray:
    """True minus nominal positions at joint values (n, 6) [m, rad], (n, 3) [m]; NaN where a pose does not close."""
    return np.asarray(forward(q, parameters).p_world_tool - forward(q, table1().nominal).p_world_tool)


def base_placed(nominal: FloatArray, true: FloatArray) -> FloatArray:
    """True minus nominal positions (n, 3) [m] after the best rigid motion of the nominal ones."""
    rotation, translation = best_transform(nominal, true)
    return np.asarray(true - (nominal @ rotation.T + translation))


def signs(q: FloatArray) -> Iterator[tuple[DistanceSummary, DistanceSummary]]:
    """Errors of Tables II and IV at joint values (n, 6) [m, rad], any combination of groups having the other sign."""
    nominal = table1().nominal
    for reversed_groups in product((1.0, -1.0), repeat=len(GROUPS)):
        factor = np.ones(len(PARAMETERS))
        for sign, group in zip(reversed_groups, GROUPS, strict=True):
            factor[[PARAMETERS.index(name) for name in group]] = sign
        errors, other = (errors_of(differences(nominal + factor * (p - nominal), q)) for p in _robots())
        yield errors, other


def rotation_orders(q: FloatArray) -> dict[str, tuple[DistanceSummary, DistanceSummary]]:
    """Errors of Tables II and IV at joint values (n, 6) [m, rad], the base's three angles read otherwise."""
    nominal = forward(q, table1().nominal).p_world_tool
    errors_by_order: dict[str, list[DistanceSummary]] = {"Rx Ry Rz": [], "transposed": []}
    for parameters in _robots():
        named = name_parameters(parameters, len(q))
        R, p = base_in_world(named)
        p_base = np.einsum("nji,nj->ni", R, forward(q, parameters).p_world_tool - p)
        other = rotation_x(named["phi_bx"]) @ rotation_y(named["phi_by"]) @ rotation_z(named["phi_bz"])
        for name, turn in (("Rx Ry Rz", other), ("transposed", np.transpose(R, (0, 2, 1)))):
            errors_by_order[name].append(errors_of(np.einsum("nij,nj->ni", turn, p_base) + p - nominal))
    return {name: (errors[0], errors[1]) for name, errors in errors_by_order.items()}


def placements(step: float = 0.1, turns: int = 8) -> Iterator[tuple[DistanceSummary, DistanceSummary]]:
    """Errors of Tables II and IV on 60 poses of every reachable half cylinder.

    The places of its axis are `step` apart [m], the directions of its middle are `turns`.
    """
    n = 60
    steps = np.arange(n)
    spread = [2 * np.remainder(0.5 + steps * root, 1) - 1 for root in (0.618, 0.755, 0.570, 0.819)]
    places = product(np.arange(-0.8, 0.85, step), np.arange(-0.6, 1.0, step), 2 * np.pi * np.arange(turns) / turns)
    for y, z, middle in places:
        around = middle + np.pi / 2 * spread[0]
        p = np.stack([0.237 + 0.25 * spread[1], y + RADIUS * np.cos(around), z + RADIUS * np.sin(around)], axis=1)
        for turned, leaning, elbows in product((0.0, np.pi), (0.0, 1.0), ELBOWS):
            lean, twist = leaning * LEAN_AT_END * spread[2], leaning * TWIST_SPREAD * spread[3]
            R = rotation_x(around + np.pi / 2 + turned) @ rotation_y(lean) @ rotation_z(twist)
            q = inverse(homogeneous(R, p), table1().nominal, WorkingMode(elbows + elbows))
            if not np.isfinite(q).all():
                continue
            deviations = [differences(parameters, q) for parameters in _robots()]
            if np.isfinite(deviations).all():
                yield errors_of(deviations[0]), errors_of(deviations[1])


def _robots() -> tuple[FloatArray, FloatArray]:
    """Parameters behind Table II and behind Table IV, (36,) [m, rad]."""
    return table1().actual, table3().identified


def main() -> None:
    """Print the errors of every reading of the text."""
    q = np.array(target_workspace().q)
    nominal = forward(q, table1().nominal).p_world_tool
    for number, parameters in zip((2, 4), _robots(), strict=True):
        moved = differences(parameters, q)
        placed = base_placed(nominal, nominal + moved)
        print(f"Table {number}: paper {error_table(number)['before']['mean']:.2f} mm; ours {errors_of(moved)}")
        print(f"  base placed beforehand: {errors_of(placed)}")
    for name, (second, fourth) in rotation_orders(q).items():
        print(f"rotation of the base {name}: Table II {second.mean:.2f} mm, Table IV {fourth.mean:.2f} mm")
    for variant, pairs in (("signs of groups", list(signs(q))), ("half cylinders", list(placements()))):
        least = min(fourth.mean for _, fourth in pairs)
        near = [sum(pair[k].is_near(error_table(n)["before"]) for pair in pairs) for k, n in ((0, 2), (1, 4))]
        print(
            f"{len(pairs)} {variant}: least mean of Table IV {least:.2f} mm; mean, largest and std within"
            f" {100 * NEAR:.0f} % of the paper's: Table II {near[0]}, Table IV {near[1]}"
        )


if __name__ == "__main__":
    main()
