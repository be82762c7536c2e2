"""GTSAM: the parameters and priors of this project as a factor graph, with a `CustomFactor` as its notes write one."""

import sys
from importlib.metadata import version

import gtsam
import numpy as np
from exchange import Answer, Problem, fit_time, main
from urdf_chain import differences, model_of


def solve(problem: Problem) -> Answer:
    # -- what a user writes
    model = model_of(problem)
    noise = model.noise_before
    n, start = model.n, model.start
    parts = np.split(np.arange(len(start)), [*range(6, n + 1, 6), n + 3])
    keys = list(range(len(parts)))

    def error(_, values, jacobians):
        x = np.concatenate([values.atVector(key) for key in keys])
        if jacobians is not None:
            every = differences(model.misses, x)
            for k, part in enumerate(parts):
                jacobians[k] = every[:, part]
        return model.misses(x)

    with fit_time():
        x = start
        for _ in range(3):
            graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
            spread = gtsam.noiseModel.Isotropic.Sigma(len(model.misses(x)), noise)
            graph.add(gtsam.CustomFactor(spread, keys, error))
            for key, part in zip(keys, parts, strict=True):
                values.insert(key, x[part])
                sizes = model.expected()[part]
                if np.all(np.isfinite(sizes)):
                    graph.add(
                        gtsam.PriorFactorVector(key, model.middle()[part], gtsam.noiseModel.Diagonal.Sigmas(sizes))
                    )
            settings = gtsam.LevenbergMarquardtParams()
            settings.setRelativeErrorTol(1e-9)
            values = gtsam.LevenbergMarquardtOptimizer(graph, values, settings).optimize()
            x = np.concatenate([values.atVector(key) for key in keys])
            noise = model.noise(x)
    # -- end
    return Answer(model.points(x, problem.unseen), model.claim(x), package=f"GTSAM {version('gtsam')}")


if __name__ == "__main__":
    sys.exit(main(solve))
