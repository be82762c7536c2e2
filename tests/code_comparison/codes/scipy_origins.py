"""Plain SciPy on the parameters of this project: every origin of the chain, base, point and sockets.

`placed`: none of the origins, the nominal robot put where it fits best. `origins`: `least_squares`, no priors, stopped
after 40 steps, as it goes on for long along what no reading tells. `priors`: the same with rows for what is expected of
each origin, weighed by the noise that solutions before show.
"""

import sys

import numpy as np
import scipy
from exchange import Answer, Problem, fit_time, main
from scipy.optimize import least_squares
from urdf_chain import model_of


def solve(problem: Problem, how: str) -> Answer:
    # -- what a user writes
    model = model_of(problem, origins=how != "placed")
    x, noise = model.start, model.noise_before
    with fit_time():
        for _ in range({"placed": 4, "priors": 3, "origins": 1}[how]):
            rest = {"noise": noise, "priors": how == "priors"}
            x = least_squares(model.rows, x, kwargs=rest, x_scale="jac", max_nfev=40).x
            noise = model.noise(x)
    # -- end
    version = f"SciPy {scipy.__version__}, NumPy {np.__version__}"
    return Answer(model.points(x, problem.unseen), model.claim(x), package=version)


if __name__ == "__main__":
    sys.exit(main(solve))
