"""The camera without the robot: the board placed freely in each image by OpenCV, and the lens that follows.

Each image has its own pose of the board, so neither the robot nor another image matters. The residuals are the
camera's part of the error; a point with a large residual contradicts the others of its image.

When it fails. An image with fewer than six points is not used, because its own pose could explain them.

References: zhang2000; OpenCV's documentation of calib3d.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays
from calib.core.base.errors import NotIdentifiableError
from calib.core.instruments.camera import LEAST_POINTS
from calib.core.numerics.chances import FALSE_ALARM
from calib.core.numerics.losses import StudentisedErrors, studentised
from calib.photographs.opencv import one_thread, opencv
from calib.photographs.scene import BoardScene, HandEyePlacement, residuals, rows

LEAST_IMAGES = 3
_LEAST_ALONE = 6  # points of an image that its own pose cannot explain exactly
_TO_THE_END = (3, 100, 1e-15)  # OpenCV's stopping rule: number of steps, and size of a step
_UNSURE = 0.2  # images do not determine a focal length with a larger relative standard deviation
_SHORTEST, _LONGEST = 0.1, 25.0  # ratio of a camera's focal length to the width of its images


@dataclass(frozen=True, eq=False)
class FreeBoards(ReadOnlyArrays):
    """The board with a free pose in each image, and the lens.

    Attributes:
        scene: The images used; its `tool` is the pose of the board in the camera.
        placed: Camera and board at the origin, with the intrinsics.
        images: Indices of these images in the original scene, (n,).
        focal_std: Standard deviation of the focal length [px]; zero if it is not fitted.
    """

    scene: BoardScene
    placed: HandEyePlacement
    images: IntArray
    focal_std: float


def free_boards(scene: BoardScene, intrinsics: FloatArray, free: tuple[int, ...] = ()) -> FreeBoards | None:
    """Return the board placed in each image with enough points; None where a pose is not determined.

    `free` are indices of the first six intrinsics; without fy, it follows fx. First values are (9,).
    """
    images = np.flatnonzero(scene.counts >= _LEAST_ALONE)
    if len(images) == 0:
        return None
    free = free if len(images) >= LEAST_IMAGES else ()
    cv2 = opencv()
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_TANGENT_DIST | cv2.CALIB_FIX_K3
    held = (cv2.CALIB_FIX_FOCAL_LENGTH, cv2.CALIB_FIX_ASPECT_RATIO, cv2.CALIB_FIX_PRINCIPAL_POINT)
    flags |= sum(
        flag for number, flag in enumerate((*held, 0, cv2.CALIB_FIX_K1, cv2.CALIB_FIX_K2)) if number not in free
    )
    body, pixels = ([part[scene.image == i].astype(np.float32) for i in images] for part in (scene.body, scene.pixels))
    known = (scene.size, _matrix(intrinsics), intrinsics[4:].copy())
    try:
        with one_thread():
            _, matrix, lens, turns, places, stds, *_ = cv2.calibrateCameraExtended(
                body, pixels, *known, flags=flags, criteria=_TO_THE_END
            )
    except cv2.error:  # points of an image lie in a line
        return None
    poses = np.array([_pose(*pose) for pose in zip(turns, places, strict=True)])
    if not np.all(np.isfinite(poses)):
        return None
    found = np.concatenate([matrix[[0, 1, 0, 1], [0, 1, 2, 2]], np.ravel(lens)[:5]])
    used = scene.select_images(np.isin(np.arange(len(scene)), images))
    # each image counts as a pose of the robot: the camera is in the base, the board on the tool
    alone = replace(used, tool=poses, mount="base")
    return FreeBoards(alone, HandEyePlacement(np.eye(4), np.eye(4), found), images, float(np.ravel(stds)[1]))


def usual_intrinsics(scene: BoardScene) -> FloatArray:
    """Return intrinsics of a usual camera, (9,): the focal length is the width of the image."""
    width, height = scene.size
    return np.array([width, width, (width - 1) / 2, (height - 1) / 2, 0.0, 0.0, 0.0, 0.0, 0.0])


def intrinsics_at_first(scene: BoardScene) -> FloatArray:
    """Return first intrinsics from the images, (9,), with a fitted focal length and no distortion.

    Raises:
        NotIdentifiableError: The images do not determine the focal length, such as images all from the front.
    """
    alone = free_boards(scene, usual_intrinsics(scene), (0,))
    focal = np.nan if alone is None else alone.placed.intrinsics[0] / scene.size[0]
    if alone is None or not (_SHORTEST < focal < _LONGEST and 0.0 < alone.focal_std < _UNSURE * focal * scene.size[0]):
        raise NotIdentifiableError(
            "the photographs do not determine the focal length; give intrinsics (--camera FILE), or tilt the board"
            " by 30 deg in some images"
        )
    return alone.placed.intrinsics


def single_views(scene: BoardScene, intrinsics: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return the board in the camera at each image, (n, 4, 4) [m], and the mask of successful images, (n,)."""
    cv2, poses = opencv(), np.full((len(scene), 4, 4), np.nan)
    for i in np.flatnonzero(scene.counts >= LEAST_POINTS):
        points = (part[scene.image == i] for part in (scene.body, scene.pixels))
        lens = (_matrix(intrinsics), intrinsics[4:])
        found, turns, places, _ = cv2.solvePnPGeneric(*points, *lens, flags=cv2.SOLVEPNP_IPPE)
        if found and turns[0] is not None:  # NaN where the points lie in a line
            poses[i] = _pose(turns[0], places[0])
    return poses, np.all(np.isfinite(poses), axis=(1, 2))


def views(scene: BoardScene) -> FloatArray:
    """Return approximate poses of the board in the camera, (k, 4, 4) [m], for the images that determine one.

    The focal length is fitted, or a usual camera's if the images do not determine it.
    """
    try:
        intrinsics = intrinsics_at_first(scene)
    except NotIdentifiableError:
        intrinsics = usual_intrinsics(scene)
    poses, found = single_views(scene, intrinsics)
    return poses[found]


def _matrix(intrinsics: FloatArray) -> FloatArray:
    return np.array([[intrinsics[0], 0.0, intrinsics[2]], [0.0, intrinsics[1], intrinsics[3]], [0.0, 0.0, 1.0]])


def _pose(turn: FloatArray, place: FloatArray) -> FloatArray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = opencv().Rodrigues(turn)[0], np.ravel(place)
    return pose


def camera_alone(scene: BoardScene, intrinsics: FloatArray, free: tuple[int, ...] = ()) -> FloatArray:
    """Return residuals of a fit without the robot, (m, 2) [px]; NaN in unused images."""
    alone = free_boards(scene, intrinsics, free)
    result = np.full_like(scene.pixels, np.nan)
    if alone is not None:
        result[np.isin(scene.image, alone.images)] = residuals(alone.scene, alone.placed)
    return result


def point_errors(scene: BoardScene, intrinsics: FloatArray, free: tuple[int, ...]) -> FloatArray:
    """Return how far outlying points are from the prediction of their image's other points, (m,) [px]; 0 for others.

    The point with the largest studentised residual is left out of its image, and the board is placed again, until
    every residual is likely by chance: a larger one occurs in one of a hundred sets of good points
    (`calib.core.numerics.losses`). If more than half of the points would be left out, or too few would stay, the image
    keeps all: then the image or its board is wrong.
    """
    far: FloatArray = np.zeros(len(scene.pixels))
    alone = free_boards(scene, intrinsics, free)
    if alone is None:
        return far
    freedom = 2 * len(alone.scene.pixels) - 6 * len(alone.images) - len(free)
    if freedom <= 0:
        return far
    every = _studentise(alone, freedom)
    for i in alone.images:
        image = scene.select_images(np.arange(len(scene)) == i)
        far[scene.image == i] = _errors_in_image(image, alone.placed.intrinsics, freedom, every)
    return far


def _errors_in_image(image: BoardScene, intrinsics: FloatArray, freedom: float, every: StudentisedErrors) -> FloatArray:
    """`point_errors` of one image; `every` has the scale and the number of all points."""
    gone: BoolArray = np.zeros(len(image.pixels), dtype=bool)
    while 2 * np.sum(gone) <= len(gone) and (alone := free_boards(image.with_points(~gone), intrinsics)) is not None:
        errors = _studentise(alone, freedom, every.scale)
        worst = int(np.argmax(errors.ratio))
        if len(every.chance) * errors.chance[worst] >= FALSE_ALARM:
            placed = replace(image, tool=alone.scene.tool, mount="base")
            return np.where(gone, np.linalg.norm(residuals(placed, alone.placed), axis=1), 0.0)
        gone[np.flatnonzero(~gone)[worst]] = True
    return np.zeros(len(gone))


def _studentise(alone: FreeBoards, freedom: float, scale: float | None = None) -> StudentisedErrors:
    """Studentised residual of every point with a free pose in each image; its scale is found if not given."""
    r, _, g = rows(alone.scene, alone.placed)
    span = np.concatenate([np.linalg.qr(g[alone.scene.image == i].reshape(-1, 6))[0] for i in range(len(alone.scene))])
    point, width = np.repeat(np.arange(len(r)), 2), np.full(len(r), 2)
    return studentised(r.ravel(), span, point, width, np.ones(len(r)), freedom, scale)
