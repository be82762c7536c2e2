"""First guesses at the fixed places of a camera and of the body that it observes.

The camera is fixed to one link by C, the body to another by M, and the robot gives the poses L_i between the links, so
that point X is seen at C^-1 L_i M X. C and M may both be unknown. Guesses come from

1. poses of single views (`calib.core.instruments.camera`) and the hand-eye problem (`calib.core.instruments.hand_eye`):
   from a few views at a time, chosen at random, since some poses are the wrong one of several solutions;
2. all points at once: with M at its place, in each orientation of a cube, C is found by resection.

Each guess is then improved by least squares over C and M together, in rays (pixels without distortion). The best few
are returned, and also one with M unchanged, since another camera may have shown M already. The random choice has a
fixed seed, so that results repeat.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import scipy

from calib.core.base.arrays import FloatArray, IntArray, evenly_spread
from calib.core.instruments.camera import LEAST_POINTS, cube_rotations, plane_errors, resection, view_poses
from calib.core.instruments.hand_eye import solve_poses
from calib.core.numerics.rigid import cross_matrices

_VIEWS = 25  # largest number of views whose poses are computed
_POINTS = 400  # largest number of sightings by which guesses are compared
_TRIALS = 60  # random choices of views
_IMPROVED = 8  # guesses improved with some sightings
_KEPT = 3  # guesses improved with all sightings
_STEPS = 60  # steps of least squares
_SEED = 0

Places = tuple[FloatArray, FloatArray]
"""C and M, (4, 4) each [m]."""


@dataclass(frozen=True, eq=False)
class Sightings:
    """Points of a body seen by a camera.

    Attributes:
        links: L_i of each sighting, (n, 4, 4) [m].
        points: X in the body's frame, (n, 3) [m].
        rays: m of `calib.core.instruments.camera`, (n, 2).
        view: Number of the view of each, (n,), from 0.
    """

    links: FloatArray
    points: FloatArray
    rays: FloatArray
    view: IntArray

    def select(self, chosen: IntArray) -> Sightings:
        """Return the sightings with these numbers, (n,); views keep their numbers."""
        return Sightings(self.links[chosen], self.points[chosen], self.rays[chosen], self.view[chosen])


def guesses(sightings: Sightings, now: Places, known: tuple[bool, bool]) -> list[Places]:
    """Return guesses at the places of camera and body, best first, from the present ones and whether each is known."""
    sample = sightings.select(evenly_spread(len(sightings.view), _POINTS))
    tried = [now, *_from_views(sightings, now, known), *_from_points(sample, now, known)]
    tried.sort(key=lambda places: _typical(sample, places))
    improved = [refine_places(sample, places, known) for places in tried[:_IMPROVED]]
    improved = [
        refine_places(sightings, places, known)
        for places in sorted(improved, key=lambda p: _typical(sample, p))[:_KEPT]
    ]
    improved.sort(key=lambda places: _typical(sightings, places))
    if any(known):
        return improved
    only_camera = sorted(_from_points(sample, now, (False, True)), key=lambda places: _typical(sample, places))
    return improved + [refine_places(sightings, places, (False, True)) for places in only_camera[:1]]


def seen_points(sightings: Sightings, places: Places) -> FloatArray:
    """Return the points in the camera's frame, (n, 3) [m]."""
    return _points_in_camera(sightings, places)[0]


def _from_views(sightings: Sightings, now: Places, known: tuple[bool, bool]) -> list[Places]:
    counts = np.bincount(sightings.view)
    best = np.argsort(-counts, kind="stable")[:_VIEWS]
    best = best[counts[best] >= LEAST_POINTS]
    needed = 3 if not any(known) else 1
    if len(best) < needed:
        return []
    number = np.full(len(counts), -1)
    number[best] = np.arange(len(best))
    chosen = np.flatnonzero(number[sightings.view] >= 0)
    poses, errors = view_poses(
        sightings.points[chosen], sightings.rays[chosen], number[sightings.view[chosen]], len(best)
    )
    first = np.array([int(np.flatnonzero(sightings.view == view)[0]) for view in best])
    links = sightings.links[first]
    solved = np.flatnonzero(np.isfinite(errors))
    if len(solved) < needed:
        return []
    generator = np.random.default_rng(_SEED)
    n = min(needed + 1, len(solved))
    subsets = np.array([generator.choice(solved, n, replace=False) for _ in range(_TRIALS)])
    guesses = solve_poses(links[subsets], poses[subsets], now, known)
    return [solve_poses(links[solved], poses[solved], now, known), *zip(*guesses, strict=True)]


def _from_points(sightings: Sightings, now: Places, known: tuple[bool, bool]) -> list[Places]:
    """Guesses with the body at its present position, in each orientation of a cube."""
    result = []
    for turn in cube_rotations():
        body = now[1].copy()
        if not known[1]:
            body[:3, :3] = body[:3, :3] @ turn
        if known[0]:
            result.append((now[0], body))
        else:
            points = np.einsum("kab,bc,kc->ka", sightings.links, body, _homogeneous(sightings.points))[:, :3]
            result += [(np.linalg.inv(pose), body) for pose in resection(points, sightings.rays)]
        if known[1]:
            break
    return result


def _homogeneous(points: FloatArray) -> FloatArray:
    return np.hstack([points, np.ones((len(points), 1))])


def _points_in_camera(sightings: Sightings, places: Places) -> tuple[FloatArray, FloatArray]:
    """Points in the camera's frame (n, 3), and rotations of the body in it (n, 3, 3)."""
    poses = np.linalg.inv(places[0]) @ sightings.links @ places[1]
    return np.einsum("kab,kb->ka", poses[:, :3], _homogeneous(sightings.points)), poses[:, :3, :3]


def _typical(sightings: Sightings, places: Places) -> float:
    """Median error of the rays, which a few mistakes do not change."""
    errors, _ = plane_errors(_points_in_camera(sightings, places)[0], sightings.rays)
    return float(np.median(np.sum(errors**2, axis=1)))


def refine_places(
    sightings: Sightings, places: Places, known: tuple[bool, bool] = (False, False), steps: int = _STEPS
) -> Places:
    """Return places after some steps of least squares over the unknown ones; far-off sightings count less."""
    free = np.repeat(np.logical_not(known), 6)
    scale = max(np.sqrt(_typical(sightings, places)), 1e-6)

    def places_at(x: FloatArray) -> Places:
        step = np.zeros(12)
        step[free] = x
        return _step_pose(places[0], step[:6]), _step_pose(places[1], step[6:])

    def errors(x: FloatArray) -> FloatArray:
        return plane_errors(_points_in_camera(sightings, places_at(x))[0], sightings.rays)[0].ravel()

    def jacobian(x: FloatArray) -> FloatArray:
        at = places_at(x)
        points, turned = _points_in_camera(sightings, at)
        by_point = plane_errors(points, sightings.rays)[1]
        n = len(points)
        by_camera = np.concatenate([-np.tile(np.eye(3), (n, 1, 1)), cross_matrices(points)], axis=2)
        by_body = np.concatenate([turned, -turned @ cross_matrices(sightings.points)], axis=2)
        step = np.zeros(12)
        step[free] = x
        by_camera[:, :, 3:] = by_camera[:, :, 3:] @ pin.Jexp3(step[3:6])
        by_camera[:, :, :3] = by_camera[:, :, :3] @ pin.exp3(step[3:6]).T
        by_body[:, :, 3:] = by_body[:, :, 3:] @ pin.Jexp3(step[9:])
        by_body[:, :, :3] = by_body[:, :, :3] @ pin.exp3(step[9:]).T
        both = np.concatenate([by_camera, by_body], axis=2)[:, :, free]
        return (by_point @ both).reshape(2 * n, -1)

    start, spread = np.zeros(int(free.sum())), 10 * scale
    x = scipy.optimize.least_squares(
        errors, start, jac=jacobian, loss="soft_l1", f_scale=spread, max_nfev=steps, x_scale="jac"
    ).x
    return places_at(x)


def _step_pose(pose: FloatArray, step: FloatArray) -> FloatArray:
    """A pose moved and turned in its own axes."""
    change = np.eye(4)
    change[:3, :3], change[:3, 3] = pin.exp3(step[3:]), step[:3]
    return pose @ change
