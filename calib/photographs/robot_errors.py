"""Errors of the robot in photographs: their sizes, and intervals of camera, board and lens that contain them.

Residuals of image i, to first order, are

    r_i = J_i x + G_i (e_i + N_i k) + noise        noise ~ N(0, s^2)
                                                   e_i ~ N(0, diag(s_t^2 s_t^2 s_t^2 s_r^2 s_r^2 s_r^2))
                                                   k ~ N(0, s_a^2)

with x the unknowns, e_i an error of the robot's tool at this image, which its points share, and k errors of the arm,
which are the same at all images.

Sizes. The columns of G for shifts and for turns of the tool, each image with its own, and the columns G N are three
families of columns of a mixed model. So the four sizes come from its restricted likelihood
(`calib.core.numerics.mixed_model`), with the priors of `calib.core.numerics.size_search` around 1 mm and 1 mrad. The
points of an image enter by the triangular factor of [G_i J_i r_i]. Its rows below the sixth do not contain G; those of
all images are reduced together.

Weights of images are the inverse of V_i = s^2 I + G_i diag(s_t^2 s_t^2 s_t^2 s_r^2 s_r^2 s_r^2) G_i^T.

Intervals. Estimates are least squares with weights W, x = A^-1 J^T W r with A = J^T W J + P. So

    cov x = A^-1 (s^2 J^T W W J + sum of s_f^2 J^T W X_f X_f^T W J + P) A^-1

with X_f the columns of the three families. The estimate depends on W alone; only the intervals contain the errors of
the arm. J^T W G N is the effect of these errors on camera and board, whether residuals show them or not. Since the four
sizes are estimates, intervals are widened by Student's t with Satterthwaite's degrees of freedom 2 v^2 / (g^T C g), for
a variance v with gradient g by the sizes, and C the inverse of their information (`calib.core.numerics.size_search`).
The intervals are of C and M in the real flange and the real base of the robot. Residuals alone would only give the C
and M that fit best to its nominal poses.

Errors of the arm. Errors of lengths and angles move an arm in the same way at similar poses. The part of this motion
that is common to all images is absorbed by camera and board and leaves no residual: an error of the last link's length
moves the camera on it. The other part shows in residuals. It gives the size of the errors, and hence the uncertainty of
camera and board from the hidden part. This needs the motion N of the tool by each error at each pose. Joint values
would give it; poses of the tool do not.

So the poses are assumed to be those of a typical arm. Its first axis is upright through the origin of the base.
Shoulder and elbow turn about level axes at right angles to the plane of the arm. Both links are 5/8 of the largest
reach, and the elbow is up. The three axes of the wrist meet in the tool, the last along its z. Each of six joints
has two angles and two lengths with errors (Denavit and Hartenberg): about and along its own axis, and about and along
the common normal with the next axis. An error d of an angle about a line through c with direction a, or of a length
along it, moves the tool at p by

    d (a x (p - c), a)    and    d (a, 0)

(translation, rotation), here in the axes of the tool. The alternative is a smooth random function of the pose. Its
correlation length would decide how much stays hidden: from half to three times the true spread. With the arm above,
intervals are nearly those with the true arm.

When it fails. Sizes of several mm or mrad from few images are found up to a fifth too small, as their prior expects
less. The intervals are wrong for an arm of another kind, for poses in a frame far from the robot's base, whose levers
are others, and for errors that grow with the load or come from the gear of one joint. Where the wrist is straight or
the tool is above the base, joints of this arm turn by much, and those of the real arm may not.

Reference: patterson1971; gelman2006; satterthwaite1946.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray, IntArray, ReadOnlyArrays
from calib.core.numerics.identifiability import reduce_rows
from calib.core.numerics.linear_model import LinearModel, RowGroups
from calib.core.numerics.mixed_model import MixedModel, SolvedModel
from calib.core.numerics.mixed_rows import MixedRows, whiten_scatter
from calib.core.numerics.prior import Prior
from calib.core.numerics.size_search import information_by_size, likeliest_sizes
from calib.photographs.scene import POSES, BoardScene, HandEyePlacement, HandEyeUnknowns, rows

EXPECTED = 1e-3
"""Expected errors of the robot, around which their sizes have a wide prior [m, rad]."""
_GAIN = 1e-7  # least fall of the cost for which the search of the sizes continues
_LINK = 5 / 8  # length of a link, over the largest reach
_MANY = 1e6  # degrees of freedom of a known size


@dataclass(frozen=True)
class ErrorSizes:
    """Sizes (sigmas) of the errors.

    Attributes:
        pixel: Error of a pixel coordinate [px].
        shift, turn: Error of the robot's tool per axis [m], [rad].
        arm: Error of each length [m] and angle [rad] of the arm; zero if not considered.
    """

    pixel: float = 1.0
    shift: float = 0.0
    turn: float = 0.0
    arm: float = 0.0

    @staticmethod
    def from_model(at: SolvedModel) -> ErrorSizes:
        """Return the sizes of `ImageRows.find_sizes`."""
        robot, pixel, _ = at.model.sizes(at.logs)
        return ErrorSizes(float(pixel[0]), *map(float, EXPECTED * robot))


@dataclass(frozen=True, eq=False)
class ImageRows(ReadOnlyArrays):
    """Pixels of a scene around a placement, by scaled unknowns (`HandEyeUnknowns.scales`) and errors of the tool.

    Attributes:
        pixels: Residuals (2 m,) [px], J (2 m, k), and the prior.
        levers: G, (2 m, 6).
        image: Image of each row, (2 m,).
    """

    pixels: LinearModel
    levers: FloatArray
    image: IntArray

    @staticmethod
    def from_scene(scene: BoardScene, placed: HandEyePlacement, unknowns: HandEyeUnknowns = POSES) -> ImageRows:
        """Return the rows of the points of a scene."""
        r, j, g = rows(scene, placed, unknowns)
        scales, deviations = unknowns.scales, np.zeros(j.shape[2])
        deviations[unknowns.lens] = (placed.intrinsics[list(unknowns.free)] - unknowns.expected) / unknowns.sigma
        pixels = LinearModel(r.ravel(), j.reshape(r.size, -1) * scales, unknowns.prior, deviations)
        return ImageRows(pixels, g.reshape(r.size, 6), np.repeat(scene.image, 2))

    def whiten(self, noise: ErrorSizes, *arrays: FloatArray) -> list[FloatArray]:
        """Return V^-1/2 times arrays of rows, (2 m, ...), by the errors of pixels and tool."""
        levers = self.levers * np.repeat([noise.shift, noise.turn], 3) / noise.pixel
        return [array / noise.pixel for array in whiten_scatter(levers, self.image, *arrays)]

    def weigh(self, noise: ErrorSizes) -> LinearModel:
        """Return the rows with the weights of these errors."""
        residuals, jacobian = self.whiten(noise, self.pixels.residuals, self.pixels.jacobian)
        return replace(self.pixels, residuals=residuals, jacobian=jacobian)

    def with_columns(self, columns: FloatArray) -> ImageRows:
        """Return the rows with further columns of J without a prior, (2 m, c)."""
        none, known = np.zeros(columns.shape[1]), self.pixels
        jacobian, prior = np.hstack([known.jacobian, columns]), Prior(np.append(known.prior.has, none > 0))
        wide = replace(known, jacobian=jacobian, prior=prior, deviations=np.append(known.deviations, none))
        return replace(self, pixels=wide)

    def find_sizes(self, twists: FloatArray | None = None) -> SolvedModel:
        """Return the mixed model with the likeliest sizes of the errors, those of pixels last.

        Errors of the arm count if `twists` are given, the motions N of the tool by each of them, (n, 6, n_arm).
        """
        known, n = self.pixels, int(self.image[-1]) + 1
        every, ends = np.hstack([self.levers, known.jacobian]), np.searchsorted(self.image, np.arange(n + 1))
        parts = [reduce_rows(every[a:b], known.residuals[a:b]) for a, b in pairwise(ends)]
        upper, lower = [part[:6] for part in parts], reduce_rows(np.vstack([part[6:, 6:] for part in parts]))
        robot = [scipy.linalg.block_diag(*[part[:, of] for part in upper]) for of in (slice(3), slice(3, 6))]
        if twists is not None:
            robot.append(np.vstack([part[:, :6] @ twist for part, twist in zip(upper, twists, strict=True)]))
        by_errors = np.pad(EXPECTED * np.hstack(robot), ((0, len(lower)), (0, 0)))
        right = np.vstack([part[:, 6:] for part in upper] + [lower])
        family = np.repeat(np.arange(-1, len(robot)), [known.jacobian.shape[1], *(part.shape[1] for part in robot)])
        model = LinearModel(
            right[:, -1],
            np.hstack([right[:, :-1], by_errors]),
            Prior(np.append(known.prior.has, np.ones(by_errors.shape[1], dtype=bool))),
            np.append(known.deviations, np.zeros(by_errors.shape[1])),
            RowGroups(np.zeros(len(right), dtype=np.intp), np.array([len(self.image)])),
        )
        found, none = np.zeros(1, dtype=bool), np.zeros((len(right), 0))
        mixed = MixedRows.from_linear_problem(model, family, found, np.arange(len(right)), none)
        return likeliest_sizes(MixedModel.from_rows(mixed), least_gain=_GAIN)


def arm_twists(tool: FloatArray) -> FloatArray:
    """Return the motion of the tool, in its axes, by 24 errors of the arm, (n, 6, 24), at poses (n, 4, 4) [m]."""
    p, axes, o = tool[:, :3, 3], tool[:, :3, :3], np.zeros((len(tool), 3))
    upright = np.tile([0.0, 0.0, 1.0], (len(tool), 1))
    level = _unit(np.cross(upright, p))
    reach = np.linalg.norm(p, axis=1, keepdims=True)
    height = np.sqrt((_LINK * np.max(reach)) ** 2 - reach**2 / 4)
    elbow = p / 2 + height * _unit(np.cross(p, level))
    forearm, last = _unit(p - elbow), axes[:, :, 2]
    bend = _unit(np.cross(forearm, last))
    lines = [
        (upright, o), (level, o), (level, elbow), (forearm, p), (bend, p), (last, p),
        (np.cross(level, upright), o), (_unit(elbow), o), (np.cross(forearm, level), elbow),
        (np.cross(bend, forearm), p), (np.cross(bend, last), p), (axes[:, :, 0], p),
    ]  # fmt: skip
    turned = [np.stack([np.cross(along, p - through), along], axis=1) for along, through in lines]
    moved = [np.stack([along, o], axis=1) for along, _ in lines]
    in_base = np.stack(turned + moved, axis=3)  # (n, 2, 3, 24)
    return np.einsum("nba,nkbc->nkac", axes, in_base).reshape(len(tool), 6, -1)


def _unit(vectors: FloatArray) -> FloatArray:
    """Unit vectors; zero for zero vectors."""
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, lengths, out=np.zeros_like(vectors), where=lengths > 1e-9)


def intervals(
    rows: ImageRows, twists: FloatArray, weights: ErrorSizes, at: SolvedModel
) -> tuple[FloatArray, FloatArray]:
    """Return the covariance of the scaled unknowns (k, k), and their degrees of freedom (k,).

    `twists` are motions of the tool by each error of the arm, (n, 6, 24), and `at` has the sizes of all errors.
    """
    model = rows.weigh(weights)
    weighed, levers = rows.whiten(weights, model.jacobian, rows.levers)
    pulls = np.zeros((len(twists), model.jacobian.shape[1], 6))  # J^T W G of each image
    np.add.at(pulls, rows.image, model.jacobian[:, :, None] * levers[:, None])
    tool = EXPECTED * pulls.transpose(1, 0, 2)
    by_size = [tool[:, :, :3], tool[:, :, 3:], EXPECTED * np.sum(pulls @ twists, axis=0), weighed.T]
    inverse, sizes = model.posterior_information.covariance, np.exp(at.logs)
    moved = [inverse @ part.reshape(len(inverse), -1) for part in by_size]  # by errors of size 1
    known = inverse[:, model.prior.has]
    covariance = known @ known.T + sum(size**2 * part @ part.T for size, part in zip(sizes, moved, strict=True))
    slopes = 2 * sizes[:, None] * np.array([np.sum(part**2, axis=1) for part in moved])
    variance = np.sum(slopes * np.linalg.solve(information_by_size(at), slopes), axis=0)
    return covariance, np.clip(2 * np.diag(covariance) ** 2 / variance, 1.0, _MANY)
