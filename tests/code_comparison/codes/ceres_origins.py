"""Ceres, through pyceres: the parameters and priors of this project as one cost function, as its readme writes one."""

import sys
from importlib.metadata import version

import pyceres
from exchange import Answer, Problem, fit_time, main
from urdf_chain import Model, differences, model_of


# -- what a user writes
class Cost(pyceres.CostFunction):
    def __init__(self, model: Model, noise: float) -> None:
        super().__init__()
        self.rows = lambda x: model.rows(x, noise, priors=True)
        self.set_num_residuals(len(self.rows(model.start)))
        self.set_parameter_block_sizes([len(model.start)])

    def Evaluate(self, parameters, residuals, jacobians):  # noqa: N802, the name that pyceres calls
        residuals[:] = self.rows(parameters[0])
        if jacobians is not None:
            jacobians[0][:] = differences(self.rows, parameters[0]).ravel()
        return True


def solve(problem: Problem) -> Answer:
    model = model_of(problem)
    noise = model.noise_before
    x = model.start.copy()
    options, summary = pyceres.SolverOptions(), pyceres.SolverSummary()
    options.linear_solver_type = pyceres.LinearSolverType.DENSE_QR
    options.minimizer_progress_to_stdout = False
    with fit_time():
        for _ in range(3):
            ceres = pyceres.Problem()
            ceres.add_residual_block(Cost(model, noise), None, [x])
            pyceres.solve(options, ceres, summary)
            noise = model.noise(x)
    # -- end
    return Answer(model.points(x, problem.unseen), model.claim(x), package=f"pyceres {version('pyceres')}")


if __name__ == "__main__":
    sys.exit(main(solve))
