"""An arm of a URDF as a product of matrices, and its residuals: NumPy and SciPy alone, no code of the project."""

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from exchange import Problem, moved, seen
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation


# -- what a user writes
class Chain:
    """The joints from one link to another, each with six errors of its origin."""

    def __init__(self, urdf: Path, base: str, link: str, names: list[str]) -> None:
        joints = {joint.find("child").get("link"): joint for joint in ElementTree.parse(urdf).findall("joint")}
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


class Model:
    """The unknowns of an arm: six errors of each origin, the point, and the base, or the sockets at each place."""

    noise_before = 1e-4  # the standard deviation of a reading that a first fit assumes [m, or px]

    def __init__(self, problem: Problem, *, origins: bool = True) -> None:
        self.problem = problem
        self.chain = Chain(problem.folder / "robot.urdf", problem.base, problem.link, problem.joints)
        self.places = np.unique(problem.read[:, 0]) if problem.spacing else ()
        self.n = 6 * len(self.chain) if origins else 0
        self.start = np.concatenate([np.zeros(self.n), problem.p_link_point, self._placed()])

    def _placed(self) -> np.ndarray:
        """The base where it was told; each line of sockets where the nominal arm has them."""
        if not self.problem.spacing:
            return np.zeros(6)
        poses, lines = self.chain.poses(self.problem.q), []
        own = poses[:, :3, :3] @ self.problem.p_link_point + poses[:, :3, 3]
        for place in self.places:
            first, second = (own[np.all(self.problem.read == [place, hole], axis=1)].mean(axis=0) for hole in (0, 1))
            line = (second - first) / np.linalg.norm(second - first)
            lines += [*(first + second) / 2, np.arctan2(line[1], line[0]), np.arcsin(line[2])]
        return np.array(lines)

    def points(self, x: np.ndarray, q: np.ndarray) -> np.ndarray:
        n = self.n
        poses = self.chain.poses(q, x[:n].reshape(-1, 6) if n else None)
        own = poses[:, :3, :3] @ x[n : n + 3] + poses[:, :3, 3]
        if self.problem.spacing:
            return own
        T = self.problem.T_measured_base @ moved(Rotation.from_rotvec(x[n + 6 :]).as_matrix(), x[n + 3 : n + 6])
        return own @ T[:3, :3].T + T[:3, 3]

    def misses(self, x: np.ndarray) -> np.ndarray:
        """Predicted less read coordinates [m]."""
        read, spacing = self.problem.read, self.problem.spacing
        points = self.points(x, self.problem.q)
        if not spacing:
            return (points - read).ravel()
        for place, (*middle, around, up) in zip(self.places, x[self.n + 3 :].reshape(-1, 5), strict=True):
            line = np.array([np.cos(around) * np.cos(up), np.sin(around) * np.cos(up), np.sin(up)])
            here = read[:, 0] == place
            points[here] -= middle + (read[here, 1:] - 0.5) * spacing * line
        return points.ravel()

    def expected(self) -> np.ndarray:
        """How far each unknown may be from its start, one standard deviation; inf: anywhere."""
        sizes = np.full(len(self.start), np.inf)
        sizes[: self.n] = np.tile(np.repeat([self.problem.length_sigma, self.problem.angle_sigma], 3), self.n // 6)
        if not self.problem.cameras:
            sizes[self.n : self.n + 3] = self.problem.point_sigma or np.inf
        return sizes

    def middle(self) -> np.ndarray:
        """Where unknowns are expected."""
        return np.concatenate([np.zeros(self.n), self.problem.point, self.start[self.n + 3 :]])

    def rows(self, x: np.ndarray, noise: float, *, priors: bool) -> np.ndarray:
        """Residuals over their standard deviations, those of priors last (without `priors`: of the point alone)."""
        sizes = self.expected()
        sizes[: self.n] = sizes[: self.n] if priors else np.inf
        told = np.isfinite(sizes)
        return np.concatenate([self.misses(x) / noise, ((x - self.middle()) / sizes)[told]])

    def noise(self, x: np.ndarray) -> float:
        """The standard deviation that the readings show [m]."""
        rank = min(self.n, 4 * len(self.problem.joints)) + len(x) - self.n
        misses = self.misses(x)
        return float(np.sqrt(np.sum(misses**2) / max(len(misses) - rank, 1)))

    def claim(self, x: np.ndarray) -> float | None:
        """The error of a point that residuals show [m]."""
        return float(np.sqrt(3)) * self.noise(x)


class Sights(Model):
    """The unknowns of an arm that cameras see: six errors of each origin, the markers on the link, the cameras."""

    noise_before = 1.0

    def __init__(self, problem: Problem, *, origins: bool = True) -> None:
        self.problem = problem
        self.chain = Chain(problem.folder / "robot.urdf", problem.base, problem.link, problem.joints)
        self.n = 6 * len(self.chain) if origins else 0
        self.start = np.zeros(self.n + 6 + 6 * len(problem.cameras))

    def points(self, x: np.ndarray, q: np.ndarray) -> np.ndarray:
        """Poses of the link, three rows of four numbers each."""
        return self.chain.poses(q, x[: self.n].reshape(-1, 6) if self.n else None)[:, :3].reshape(-1, 12)

    def misses(self, x: np.ndarray) -> np.ndarray:
        """Predicted less read pixels."""
        read, link = self.problem.read, self.chain.poses(self.problem.q, x[: self.n].reshape(-1, 6) if self.n else None)
        markers, *cameras = (
            moved(Rotation.from_rotvec(part[3:]).as_matrix(), part[:3]) for part in x[self.n :].reshape(-1, 6)
        )
        off = np.zeros((len(read), 2))
        for k, (told, camera) in enumerate(zip(self.problem.cameras, cameras, strict=True)):
            here = read[:, 0] == k
            places = np.array(told["T_base_camera"]) @ camera, self.problem.T_link_markers @ markers
            off[here] = seen(link[here], read[here, 1:4], *places, told["lens"]) - read[here, 4:]
        return off.ravel()

    def middle(self) -> np.ndarray:
        return self.start

    def claim(self, x: np.ndarray) -> float | None:
        """Residuals are pixels, and say nothing in metres."""
        return None


def model_of(problem: Problem, *, origins: bool = True) -> Model:
    """The unknowns and the residuals of what was read."""
    return (Sights if problem.cameras else Model)(problem, origins=origins)


def differences(function, x: np.ndarray) -> np.ndarray:
    """Central differences of a function, (n_values, n_unknowns)."""
    steps = 1e-6 * np.eye(len(x))
    return np.column_stack([(function(x + step) - function(x - step)) / 2e-6 for step in steps])


# -- end


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
