"""An arm of a URDF as a product of matrices, and its first placing: NumPy and SciPy alone, no code of the project."""

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from exchange import moved
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation


class Chain:
    """The joints from one link to another, each with six errors of its origin."""

    def __init__(self, urdf: Path, base: str, link: str, names: list[str]) -> None:
        joints = {joint.find("child").get("link"): joint for joint in ElementTree.parse(urdf).getroot().iter("joint")}
        self.origins, self.axes, self.columns, self.slides = [], [], [], []
        while link != base:
            if link not in joints:
                raise ValueError(f"{urdf}: no joint leads from {base} to {link}")
            joint = joints[link]
            origin, axis = joint.find("origin"), joint.find("axis")
            told = {} if origin is None else origin.attrib
            xyz, rpy = (np.array(told.get(key, "0 0 0").split(), float) for key in ("xyz", "rpy"))
            self.origins.insert(0, moved(Rotation.from_euler("xyz", rpy).as_matrix(), xyz))
            direction = np.array([1.0, 0, 0] if axis is None else axis.get("xyz").split(), float)
            self.axes.insert(0, direction / (np.linalg.norm(direction) or 1.0))
            name = joint.get("name")
            self.columns.insert(0, names.index(name) if name in names else None)
            self.slides.insert(0, joint.get("type") == "prismatic")
            link = joint.find("parent").get("link")

    def __len__(self) -> int:
        return len(self.origins)

    def poses(self, q: np.ndarray, errors: np.ndarray | None = None) -> np.ndarray:
        """Poses (n, 4, 4) of the last link in the first, at joints (n, n_joints); errors (n_origins, 6) [m, rad]."""
        poses = np.tile(np.eye(4), (len(q), 1, 1))
        for k, origin in enumerate(self.origins):
            poses = poses @ origin
            if errors is not None:
                poses = poses @ moved(Rotation.from_rotvec(errors[k, 3:]).as_matrix(), errors[k, :3])
            if self.columns[k] is not None:
                along = q[:, self.columns[k], None] * self.axes[k]
                turn = np.tile(np.eye(3), (len(q), 1, 1)) if self.slides[k] else Rotation.from_rotvec(along).as_matrix()
                poses = poses @ moved(turn, along if self.slides[k] else np.zeros_like(along))
        return poses


def placed(
    poses: np.ndarray, read: np.ndarray, point: np.ndarray, sigma: float | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the base in the measurement frame, (4, 4), and the point on the link, (3,), that explain readings best.

    By turns: where the base is, in closed form (Kabsch), for a point; least squares over the point. Within `sigma`
    of its nominal place, if that is known, weighed by 0.1 mm for a reading.
    """

    def base_for(p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        own = poses[:, :3, :3] @ p + poses[:, :3, 3]
        turn, _ = Rotation.align_vectors(read - read.mean(axis=0), own - own.mean(axis=0))
        T = moved(turn.as_matrix(), read.mean(axis=0) - turn.apply(own.mean(axis=0)))
        return T, own @ T[:3, :3].T + T[:3, 3] - read

    def misses(p: np.ndarray) -> np.ndarray:
        near = [] if sigma is None else (p - point) / sigma * 1e-4
        return np.concatenate([base_for(p)[1].ravel(), near])

    best = least_squares(misses, point, x_scale=0.1)
    return base_for(best.x)[0], best.x
