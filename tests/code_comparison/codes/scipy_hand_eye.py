"""Plain SciPy over the pixels, no weights: `given`, camera and board placed; `found`, and fx fy cx cy k1 k2."""

import sys

import numpy as np
import scipy
from exchange import Answer, Photographs, fit_time, main, moved, seen
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation


def solve(problem: Photographs, lens: str) -> Answer:
    # -- what a user writes
    given = np.array([*problem.intrinsics, 0, 0])
    tool = problem.tool[problem.image]

    def placed(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        steps = (moved(Rotation.from_rotvec(x[k + 3 : k + 6]).as_matrix(), x[k : k + 3]) for k in (0, 6))
        camera, board = (T @ step for T, step in zip((problem.T_base_camera, problem.T_tool_board), steps, strict=True))
        return camera, board, x[12:] if lens == "found" else given

    def misses(x: np.ndarray) -> np.ndarray:
        return (seen(tool, problem.corners, *placed(x)) - problem.pixels).ravel()

    start = np.concatenate([np.zeros(12), given if lens == "found" else []])
    with fit_time():
        x = least_squares(misses, start, x_scale="jac", max_nfev=500).x
    # -- end
    claim = float(np.sqrt(2 * np.mean(misses(x) ** 2)))
    return Answer(problem.predicted(*placed(x)), claim, package=f"SciPy {scipy.__version__}, NumPy {np.__version__}")


if __name__ == "__main__":
    sys.exit(main(solve, Photographs))
