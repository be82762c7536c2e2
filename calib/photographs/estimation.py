"""Camera, board and lens from photographs, with the errors that the points of an image share.

Problem. Residuals of image i, to first order, are r_i = J_i x + G_i e_i + noise: x is what is sought, e_i an error of
the robot's tool there (6 components), and the noise of pixels is independent. With S = diag(s_t s_t s_t s_r s_r s_r),

    cov r_i = V_i = s^2 I + G_i S^2 G_i^T,   V_i^-1 = (I - G_i K_i G_i^T) / s^2,   K_i = S (s^2 I + S G_i^T G_i S)^-1 S

so that least squares weighed by it needs only sums over the points of each image (`calib.photographs.scene`):

    A = sum of (J^T J - J^T G K G^T J) / s^2 + P,        b = sum of (J^T r - J^T G K G^T r) / s^2 + P (x - x_prior)

(P: priors of intrinsics). Gauss-Newton steps x -= A^-1 b. The three sizes s, s_t, s_r come from restricted maximum
likelihood: they make

    sum of log det V_i  +  log det A  +  r^T V^-1 r - b^T A^-1 b

smallest. It is solved by L-BFGS in their logarithms from several starts and polished by Newton steps, so that rounding
alone decides the last digits. A robot that is exact gets s_t = s_r = 0, which is plain least squares.

Plain least squares (V = s^2 I) with the covariance A^-1 (sum of J^T V J) A^-1 / s^4 is the other choice. Weights
believe what differs within an image more than what differs between images: right where the robot errs, wrong where lens
or board are not as modelled, and blind to robots whose errors follow the pose. So whoever asks takes weights only where
they predict images that were left out better (`calib.photographs.hand_eye_calibration`).

Why. An image of 24 corners has 48 rows, but its robot pose is wrong once. Counted as independent, intervals are several
times too narrow, and images near the board, where the robot's error is many pixels, drown those far from it.

Uncertainty. The covariance is A^-1; that s, s_t and s_r are found from the data widens intervals by Student's t with
Satterthwaite's degrees of freedom: 2 v^2 / (g^T W g) for a variance v with gradient g by the logarithms of the sizes,
and W the inverse of half the curvature of the criterion.

When it fails. Errors of a robot are not independent from pose to pose: those that follow the pose smoothly go into C
and M, and no image of the same region shows it. Images left out in turn are blind to it as well.

Reference: patterson1971, satterthwaite1946.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from calib.base.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays
from calib.base.errors import NotConvergedError, NotIdentifiableError
from calib.photographs.scene import Linear, Placed, Scene, linearised

_STEPS = 40
_ENDS = 1e-13  # relative fall of the step below which rounding decides
_NOISE_ROUNDS = 12
_NOISE_STANDS = 1e-8
_SMALLEST = 1e-8  # s_t [m] and s_r [rad] that count as none
_SINGULAR = 1e-7  # of scaled columns: a direction that the images do not show
_FAR = 1e12  # of a criterion that cannot be computed
_STARTS = ((3e-4, 3e-4), (3e-3, 1e-4), (1e-4, 3e-3))  # s_t [m], s_r [rad]


@dataclass(frozen=True)
class Noise:
    """Sizes of the errors: of a pixel coordinate [px], and of the robot's tool, per axis [m], [rad]."""

    pixel: float = 1.0
    shift: float = 0.0
    turn: float = 0.0

    @property
    def sizes(self) -> FloatArray:
        """Diagonal of S, (6,)."""
        return np.repeat([self.shift, self.turn], 3)


@dataclass(frozen=True, eq=False)
class Prior(ReadOnlyArrays):
    """How far intrinsics are expected from values: both (k,), of those that are sought; infinite sigma for nothing."""

    values: FloatArray
    sigma: FloatArray


@dataclass(frozen=True, eq=False)
class Estimate(ReadOnlyArrays):
    """A solution.

    Attributes:
        placed: Where camera and board are.
        free: Which intrinsics were sought, by their numbers.
        noise: Sizes of the errors.
        weights: What images were weighed by: the same, or of pixels alone for plain least squares.
        covariance: Of [camera 6, board 6, intrinsics, (scale)], in their own axes [m, rad, px, 1].
        freedom: Satterthwaite's degrees of freedom of each of them.
        scaled: Whether the size of the board was sought.
    """

    placed: Placed
    free: tuple[int, ...]
    noise: Noise
    weights: Noise
    covariance: FloatArray
    freedom: FloatArray
    scaled: bool = False


def _gains(linear: Linear, noise: Noise) -> FloatArray:
    """K_i of the module docstring, (n, 6, 6)."""
    s = noise.sizes
    inner = noise.pixel**2 * np.eye(6) + s[:, None] * linear.gg * s
    return s[:, None] * np.linalg.solve(inner, np.broadcast_to(np.diag(s), inner.shape))


def normal_equations(
    linear: Linear, noise: Noise, prior: Prior | None, now: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """Return A (k, k), b (k,) and r^T V^-1 r with the prior's part; see the module docstring.

    Args:
        linear: Sums over images.
        noise: Sizes of the errors.
        prior: Of the intrinsics that are sought.
        now: These, as they are.
    """
    gain, square = _gains(linear, noise), noise.pixel**2
    jgk = linear.jg @ gain
    a = np.sum(linear.jj - jgk @ linear.jg.transpose(0, 2, 1), axis=0) / square
    b = np.sum(linear.jr - np.einsum("nab,nb->na", jgk, linear.gr), axis=0) / square
    c = float(np.sum(linear.rr - np.einsum("na,nab,nb->n", linear.gr, gain, linear.gr))) / square
    if prior is not None and len(now):
        weight = 1.0 / prior.sigma**2
        lens = 12 + np.arange(len(now))
        a[lens, lens] += weight
        b[lens] += weight * (now - prior.values)
        c += float(np.sum(weight * (now - prior.values) ** 2))
    return a, b, c


def _criterion(linear: Linear, noise: Noise, prior: Prior | None, now: FloatArray) -> float:
    """Minus twice the restricted log-likelihood, but for a constant."""
    a, b, c = normal_equations(linear, noise, prior, now)
    s = noise.sizes
    inner = np.eye(6) + s[:, None] * linear.gg * s / noise.pixel**2
    log_v = float(np.sum(np.linalg.slogdet(inner)[1]) + 2 * np.sum(linear.n_rows) * np.log(noise.pixel))
    if not np.all(np.diag(a) > 0):  # rounding, where the sizes are far from what they can be
        return _FAR
    scale = 1.0 / np.sqrt(np.diag(a))
    scaled = scale[:, None] * a * scale
    log_a = float(np.linalg.slogdet(scaled)[1] - 2 * np.sum(np.log(scale)))
    return log_v + log_a + c - float((scale * b) @ np.linalg.solve(scaled, scale * b))


def _noise_of(logs: FloatArray) -> Noise:
    pixel, shift, turn = np.exp(logs)
    return Noise(float(pixel), 0.0 if shift < _SMALLEST else float(shift), 0.0 if turn < _SMALLEST else float(turn))


def found_noise(linear: Linear, prior: Prior | None, now: FloatArray, near: Noise | None = None) -> Noise:
    """Return the sizes of the errors by restricted maximum likelihood, the intrinsics sought being `now`, (k,)."""
    low = np.log([1e-3, 0.3 * _SMALLEST, 0.3 * _SMALLEST])
    bounds = list(zip(low, np.log([1e3, 0.1, 0.1]), strict=True))

    def cost(logs: FloatArray) -> float:
        return _criterion(linear, _noise_of(logs), prior, now)

    rough = np.sqrt(float(np.sum(linear.rr)) / max(float(np.sum(linear.n_rows)) - linear.jr.shape[1], 1.0))
    pixel = np.clip(rough / 2, 2e-3, 500.0)
    starts = [np.log([pixel, *start]) for start in _STARTS] if near is None else []
    if near is not None:
        starts = [np.log(np.maximum([near.pixel, near.shift, near.turn], [1e-3, 1e-6, 1e-6]))]
    best = min(
        (scipy.optimize.minimize(cost, start, method="L-BFGS-B", bounds=bounds) for start in starts),
        key=lambda end: end.fun,
    )
    return _noise_of(_polished(cost, np.asarray(best.x), low))


def _polished(cost: Callable[[FloatArray], float], at: FloatArray, low: FloatArray) -> FloatArray:
    """Newton steps by central differences, over sizes that are not at their smallest."""
    for _ in range(4):
        free = np.flatnonzero(np.exp(at) > 30 * _SMALLEST)
        gradient, curvature = _differences(cost, at, free)
        values, vectors = np.linalg.eigh(curvature)
        if len(values) == 0 or values.min() <= 1e-6:
            break
        step = vectors @ ((vectors.T @ gradient) / values)
        if np.max(np.abs(step)) > 0.5:
            break
        at = at.copy()
        at[free] -= step
        if np.max(np.abs(step)) < 1e-9:
            break
    return np.maximum(at, low)


def _differences(cost: Callable[[FloatArray], float], at: FloatArray, free: IntArray) -> tuple[FloatArray, FloatArray]:
    """Gradient and curvature by central differences, (k,) and (k, k)."""
    h, k = 1e-3, len(free)
    gradient, curvature = np.zeros(k), np.zeros((k, k))
    unit = np.eye(len(at))[free] * h
    centre = cost(at)
    ahead = [cost(at + step) for step in unit]
    back = [cost(at - step) for step in unit]
    for i in range(k):
        gradient[i] = (ahead[i] - back[i]) / (2 * h)
        curvature[i, i] = (ahead[i] - 2 * centre + back[i]) / h**2
        for j in range(i):
            corners = [cost(at + a * unit[i] + b * unit[j]) * a * b for a in (1, -1) for b in (1, -1)]
            curvature[i, j] = curvature[j, i] = sum(corners) / (4 * h**2)
    return gradient, curvature


def solve(
    scene: Scene,
    start: Placed,
    free: Sequence[int],
    noise: Noise,
    prior: Prior | None = None,
    *,
    scaled: bool = False,
    steps: int = _STEPS,
) -> Placed:
    """Return the minimum by damped Gauss-Newton steps, with the noise as it is.

    Args:
        scene: The images.
        start: Where to begin.
        free: Which intrinsics are sought.
        noise: Sizes of the errors.
        prior: Of the intrinsics that are sought.
        scaled: Whether the size of the board is sought.
        steps: At most so many.
    """
    placed, damping, last = start, 0.0, np.inf
    free = list(free)
    a, b, cost = normal_equations(linearised(scene, placed, free, scaled), noise, prior, placed.intrinsics[free])
    for _ in range(steps):
        scale = 1.0 / np.sqrt(np.diag(a) + 1e-300)
        inner = scale[:, None] * a * scale + (damping + 1e-14) * np.eye(len(a))
        step = -scale * np.linalg.solve(inner, scale * b)
        size = float(np.linalg.norm(step / scale)) / (1.0 + np.sqrt(cost))
        tried = placed.moved(step, free)
        if np.any(tried.intrinsics[:2] <= 0) or tried.scale <= 0:
            damping = max(10 * damping, 1e-3)
            continue
        ahead = normal_equations(linearised(scene, tried, free, scaled), noise, prior, tried.intrinsics[free])
        if not ahead[2] <= cost * (1 + 1e-12) + 1e-18:
            if size < 1e-9:
                break
            damping = max(10 * damping, 1e-4)
            continue
        placed, (a, b, cost), damping = tried, ahead, damping / 10 if damping > 1e-8 else 0.0
        if size < _ENDS or (size < 1e-9 and size >= 0.5 * last):
            break
        last = size
    return placed


def estimate(
    scene: Scene,
    start: Placed,
    free: Sequence[int],
    prior: Prior | None = None,
    *,
    scaled: bool = False,
    weighed: bool = False,
    near: Noise | None = None,
) -> Estimate:
    """Return camera, board and lens with their noise and uncertainty.

    Args:
        scene: The images.
        start: Where to begin.
        free: Which intrinsics are sought.
        prior: Of these.
        scaled: Whether the size of the board is sought.
        weighed: Whether images are weighed by the errors that their points share; else every point counts the same.
        near: Sizes of the errors of a similar problem, to begin with.

    Raises:
        NotIdentifiableError: The images do not determine all of it.
        NotConvergedError: The noise was not found.
    """
    free = tuple(free)
    if not weighed:
        placed, weights = plain(scene, start, free, prior, scaled=scaled)
        linear = linearised(scene, placed, free, scaled)
        noise = found_noise(linear, prior, placed.intrinsics[list(free)], near)
        return _finished(linear, placed, free, noise, weights, prior, scaled)
    placed, before = start, near
    for _ in range(_NOISE_ROUNDS):
        linear = linearised(scene, placed, free, scaled)
        noise = found_noise(linear, prior, placed.intrinsics[list(free)], before)
        placed = solve(scene, placed, free, noise, prior, scaled=scaled)
        if before is not None and _alike(before, noise):
            break
        before = noise
    else:
        raise NotConvergedError("the noise of the photographs could not be found from what is left")
    linear = linearised(scene, placed, free, scaled)
    require_determined(normal_equations(linear, noise, prior, placed.intrinsics[list(free)])[0], scene)
    return _finished(linear, placed, free, noise, noise, prior, scaled)


def plain(
    scene: Scene, start: Placed, free: Sequence[int], prior: Prior | None = None, *, scaled: bool = False
) -> tuple[Placed, Noise]:
    """Return the solution of plain least squares, against priors with the noise that is left, and that noise.

    Args:
        scene: The images.
        start: Where to begin.
        free: Which intrinsics are sought.
        prior: Of these.
        scaled: Whether the size of the board is sought.

    Raises:
        NotIdentifiableError: The images do not determine all of it.
    """
    placed, weights = solve(scene, start, free, Noise(), scaled=scaled) if prior is None else start, Noise()
    for _ in range(1 if prior is None else _NOISE_ROUNDS):
        linear = linearised(scene, placed, free, scaled)
        left = max(float(np.sum(linear.n_rows)) - linear.jr.shape[1], 1.0)
        before, weights = weights, Noise(max(float(np.sqrt(np.sum(linear.rr) / left)), 1e-6))
        if prior is not None:
            placed = solve(scene, placed, free, weights, prior, scaled=scaled)
        if abs(before.pixel - weights.pixel) < _NOISE_STANDS * weights.pixel:
            break
    linear = linearised(scene, placed, free, scaled)
    require_determined(normal_equations(linear, weights, prior, placed.intrinsics[list(free)])[0], scene)
    return placed, weights


def _alike(noise: Noise, other: Noise) -> bool:
    first, second = (np.array([n.pixel, n.shift, n.turn]) for n in (noise, other))
    return bool(np.all(np.abs(first - second) <= _NOISE_STANDS * np.maximum(first, second) + 1e-12))


def _finished(
    linear: Linear,
    placed: Placed,
    free: tuple[int, ...],
    noise: Noise,
    weights: Noise,
    prior: Prior | None,
    scaled: bool,
) -> Estimate:
    now = placed.intrinsics[list(free)]
    logs = np.log(np.maximum([noise.pixel, noise.shift, noise.turn], 0.3 * _SMALLEST))
    sizes = np.flatnonzero(np.exp(logs) > 30 * _SMALLEST)
    information = normal_equations(linear, weights, prior, now)[0]
    inverse = np.linalg.inv(information)

    def covariance_of(at: FloatArray) -> FloatArray:
        if weights is noise:
            return np.linalg.inv(normal_equations(linear, _noise_of(at), prior, now)[0])
        pixel, shared = np.exp(at[0]), np.repeat(np.exp(2 * at[1:]), 3)
        scatter = pixel**2 * np.sum(linear.jj, axis=0) + np.sum(
            (linear.jg * shared) @ linear.jg.transpose(0, 2, 1), axis=0
        )
        scatter = scatter / weights.pixel**4
        if prior is not None and free:
            lens = 12 + np.arange(len(free))
            scatter[lens, lens] += 1.0 / prior.sigma**2
        return inverse @ scatter @ inverse

    def cost(at: FloatArray) -> float:
        return _criterion(linear, _noise_of(at), prior, now)

    covariance = covariance_of(logs)
    _, curvature = _differences(cost, logs, sizes)
    unit = np.eye(3)[sizes] * 1e-3
    slopes = [(np.diag(covariance_of(logs + step)) - np.diag(covariance_of(logs - step))) / 2e-3 for step in unit]
    slope = np.array(slopes).reshape(len(sizes), -1)
    spread = np.linalg.pinv(curvature / 2, hermitian=True)
    variance = np.einsum("ik,ij,jk->k", slope, spread, slope)
    freedom = np.where(variance > 0, 2 * np.diag(covariance) ** 2 / np.maximum(variance, 1e-300), 1e6)
    return Estimate(placed, free, noise, weights, covariance, np.clip(freedom, 1.0, 1e6), scaled)


def require_determined(a: FloatArray, scene: Scene) -> None:
    """Raise `NotIdentifiableError` unless all that is sought shows in A of the module docstring, (k, k)."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(a), 1e-300))
    values = np.linalg.eigvalsh(scale[:, None] * a * scale)
    if values[0] > _SINGULAR**2 * values[-1] and np.all(np.isfinite(values)):
        return
    axes = turning(scene)
    raise NotIdentifiableError(
        f"these {len(scene)} images do not determine where camera and board are: the tool turned by"
        f" {np.rad2deg(axes[0]):.1f} deg about its main axis and {np.rad2deg(axes[1]):.1f} deg about another"
        f" one; turn it"
        " about two axes or more, by 20 deg or more"
    )


def turning(scene: Scene) -> FloatArray:
    """Return how far the tool turned: spreads about three axes at right angles, largest first, (3,) [rad]."""
    rotations = scene.tool[:, :3, :3]
    middle = scipy.spatial.transform.Rotation.from_matrix(rotations).mean().as_matrix()
    turns = scipy.spatial.transform.Rotation.from_matrix(middle.T @ rotations).as_rotvec()
    return (
        np.linalg.svd(turns, compute_uv=False)[:3] * 2 / np.sqrt(max(len(scene), 1)) if len(scene) > 2 else np.zeros(3)
    )


def left_out(
    scene: Scene,
    placed: Placed,
    free: Sequence[int],
    weights: Noise,
    prior: Prior | None = None,
    *,
    scaled: bool = False,
) -> list[Placed]:
    """Return the solution without each image in turn, in order.

    Args:
        scene: The images.
        placed: The solution of all.
        free: Which intrinsics are sought.
        weights: What images are weighed by; they stay as they are.
        prior: Of the intrinsics.
        scaled: Whether the size of the board is sought.
    """
    result = []
    for i in range(len(scene)):
        others: BoolArray = np.arange(len(scene)) != i
        result.append(solve(scene.only(others), placed, free, weights, prior, scaled=scaled, steps=6))
    return result
