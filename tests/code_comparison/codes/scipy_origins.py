"""Plain SciPy on the parameters of this project: every origin of the chain, base, point and sockets.

`placed`: none of the origins, the nominal robot put where it fits best. `origins`: `least_squares`, no priors, stopped
after 40 steps, as it goes on for long along what no reading tells. `priors`: the same with rows for what is expected of
each origin, weighed by the noise that solutions before show.
"""

import sys

import numpy as np
import scipy
from exchange import Answer, Problem, fit_time, main, moved
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from urdf_chain import Chain


def solve(problem: Problem, how: str) -> Answer:
    # -- what a user writes
    chain = Chain(problem.folder / "robot.urdf", problem.base, problem.link, problem.joints)
    n = 6 * len(chain) if how != "placed" else 0
    places = np.unique(problem.read[:, 0]) if problem.spacing else ()
    start = np.concatenate([np.zeros(n), problem.p_link_point, np.zeros(5 * len(places) if problem.spacing else 6)])

    def points(x: np.ndarray, q: np.ndarray) -> np.ndarray:
        poses = chain.poses(q, x[:n].reshape(-1, 6) if n else None)
        own = poses[:, :3, :3] @ x[n : n + 3] + poses[:, :3, 3]
        if problem.spacing:
            return own
        T = problem.T_measured_base @ moved(Rotation.from_rotvec(x[n + 6 :]).as_matrix(), x[n + 3 : n + 6])
        return own @ T[:3, :3].T + T[:3, 3]

    def sockets(x: np.ndarray) -> np.ndarray:
        result = np.zeros((len(problem.q), 3))
        for place, (*middle, around, up) in zip(places, x[n + 3 :].reshape(-1, 5), strict=True):
            line = [np.cos(around) * np.cos(up), np.sin(around) * np.cos(up), np.sin(up)]
            here = problem.read[:, 0] == place
            result[here] = middle + (problem.read[here, 1:] - 0.5) * problem.spacing * np.array(line)
        return result

    if problem.spacing:
        own = points(start, problem.q)
        for k, place in enumerate(places):
            first, second = (own[np.all(problem.read == [place, hole], axis=1)].mean(axis=0) for hole in (0, 1))
            line = (second - first) / np.linalg.norm(second - first)
            at = n + 3 + 5 * k
            start[at : at + 5] = *(first + second) / 2, np.arctan2(line[1], line[0]), np.arcsin(line[2])

    def misses(x: np.ndarray) -> np.ndarray:
        return (points(x, problem.q) - (sockets(x) if problem.spacing else problem.read)).ravel()

    def rows(x: np.ndarray, noise: float) -> np.ndarray:
        parts = [misses(x) / noise]
        if how == "priors":
            parts.append((x[:n].reshape(-1, 6) / np.repeat([problem.length_sigma, problem.angle_sigma], 3)).ravel())
        if problem.point_sigma:
            parts.append((x[n : n + 3] - problem.point) / problem.point_sigma)
        return np.concatenate(parts)

    noise, rank = 1e-4, min(n, 4 * len(problem.joints)) + len(start) - n
    with fit_time():
        for _ in range({"placed": 4, "priors": 3, "origins": 1}[how]):
            start = least_squares(rows, start, args=(noise,), x_scale="jac", max_nfev=40).x
            noise = float(np.sqrt(np.sum(misses(start) ** 2) / max(3 * len(problem.q) - rank, 1)))
    # -- end
    version = f"SciPy {scipy.__version__}, NumPy {np.__version__}"
    return Answer(points(start, problem.unseen), np.sqrt(3) * noise, package=version)


if __name__ == "__main__":
    sys.exit(main(solve))
