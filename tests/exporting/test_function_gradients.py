"""Robots as functions in jax, torch and CasADi, where these are installed: poses, and derivatives through the loops."""

import os

# of functions that run a few times, compiling takes nearly all of the time
os.environ["XLA_FLAGS"] = "--xla_backend_optimization_level=0 --xla_llvm_disable_expensive_passes=true"

import numpy as np
import pytest

from tests.exporting.function_robots import ROBOTS, by_name, exported, poses_of_engine, some_conditions

N = 6
NAMES = ("five-bar", "six-axis arm, every term", "Stewart platform, compliance")
JAX = pytest.param("jax", marks=pytest.mark.amount(0, 2))
"""It compiles the five-bar for a quarter of a minute, the arm for as long, and the platform for more than a minute."""
LIBRARIES = (JAX, *(pytest.param(name, marks=pytest.mark.amount(3, 3)) for name in ("torch", "casadi")))


class Gradients:
    """Poses of commands, and their derivatives by the commands, (n, 4, 4, n_joints), as a library finds them."""

    def __init__(self, library, module):
        self.package, self.module = pytest.importorskip(library), module

    def poses(self, q, given):
        if self.package.__name__ != "casadi":
            return np.asarray(self.module.forward(q, **given))
        flat = np.array(self.module.forward(q.T, **_columns(given)))
        return flat.reshape(4, len(q), 4).swapaxes(0, 1)

    def rates(self, q, given):
        return {"jax": self._of_jax, "torch": self._of_torch, "casadi": self._of_casadi}[self.package.__name__](
            q, given
        )

    def jacobian(self, q, given):
        if self.package.__name__ != "casadi":
            return np.asarray(self.module.jacobian(q, **given))
        flat = np.array(self.module.jacobian(q.T, **_columns(given)))
        return flat.reshape(6, len(q), -1).swapaxes(0, 1)

    def _of_jax(self, q, given):
        def of_one(q, given):
            return self.module.forward(q, **given)

        return np.asarray(self.package.vmap(self.package.jacrev(of_one))(q, given))

    def _of_torch(self, q, given):
        commands = self.package.tensor(q, requires_grad=True)
        poses = self.module.forward(commands, **given)
        rates = np.zeros((len(q), 4, 4, q.shape[1]))
        for i, j in np.ndindex(3, 4):
            (rate,) = self.package.autograd.grad(poses[:, i, j].sum(), commands, retain_graph=True)
            rates[:, i, j] = rate.numpy()
        return rates

    def _of_casadi(self, q, given):
        symbol = self.package.MX.sym("q", q.shape[1])
        rates = []
        for k, commands in enumerate(q):
            here = {name: self.package.DM(np.atleast_1d(value[k])) for name, value in given.items()}
            pose = self.package.vec(self.module.forward(symbol, **here))
            slope = self.package.Function("slope", [symbol], [self.package.jacobian(pose, symbol)])
            rates.append(np.array(slope(commands)).reshape(4, 4, -1).swapaxes(0, 1))
        return np.array(rates)


def writable(given):
    """Copies: conditions of the engine are read-only, which torch warns of."""
    return {name: value.copy() for name, value in given.items()}


def _columns(given):
    return {name: np.atleast_2d(value.T) for name, value in given.items()}


@pytest.mark.quick(0)
@pytest.mark.parametrize("library", LIBRARIES)
def test_derivatives_are_those_of_the_engine_and_open_loops_are_no_numbers(library, tmp_path, amount):
    pytest.importorskip(library)
    for name in NAMES[:amount]:
        robot = ROBOTS[name](tmp_path)
        q = robot.sample(N, 3)
        context = some_conditions(robot, N)
        module = exported(robot, library, tmp_path)
        given, gradients = writable(by_name(module, context)), Gradients(library, module)
        truth = poses_of_engine(robot, q, context)
        assert np.abs(gradients.poses(q, given) - truth).max() < 1e-11
        rates = gradients.rates(q, given)
        # against the analytic derivative of the file in numpy, which test_functions holds against the engine
        motion = exported(robot, "numpy", tmp_path).jacobian(q, **given)
        assert np.abs(rates[:, :3, 3] - motion[:, :3]).max() < 1e-9
        spin = np.einsum("nikj,nlk->nilj", rates[:, :3, :3], truth[:, :3, :3])
        turning = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1)
        assert np.abs(turning - motion[:, 3:]).max() < 1e-9
        assert np.abs(gradients.jacobian(q, given) - motion).max() < 1e-9
        if name == "five-bar":
            q[2] = 0.005, 0.729
            assert not robot.close(q).ok[2]
            poses = gradients.poses(q, given)
            assert np.array_equal(np.isnan(poses).all(axis=(1, 2)), np.arange(N) == 2)
