"""OMPL's RRT-Connect between two commands, with checks of whole moves. An extra, loaded only if it is needed.

OMPL draws its random numbers from one seed for each process, so a command gives the same paths each time.
"""

from __future__ import annotations

import atexit
import gc
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
from ompl import base, geometric, util

from calib.core.base.arrays import FloatArray

_STEP = 1.0  # largest step of a joint between neighbours in OMPL's trees [m or rad]
_SEED = 57
_MOST_CHECKS = 150  # moves

util.noOutputHandler()
util.RNG.setSeed(_SEED)


@atexit.register
def _let_go() -> None:
    """Release all objects of OMPL at exit; otherwise its bindings write a page about them to standard error."""
    for name in [name for name in sys.modules if name == "ompl" or name.startswith("ompl.")]:
        vars(sys.modules.pop(name)).clear()
    for name in ("ProvenMotions", "base", "geometric", "util"):
        globals().pop(name, None)
    gc.unfreeze()  # the program may have frozen these objects, and frozen objects are not collected
    gc.collect()


class ProvenMotions(base.MotionValidator):  # type: ignore[misc]
    """Motion validator that checks whole moves."""

    def __init__(self, information: Any, is_free: Callable[[FloatArray, FloatArray], bool], n: int) -> None:
        super().__init__(information)
        self._is_free, self._n, self.n_checked = is_free, n, 0

    def checkMotion(self, one: Any, other: Any, *_: Any) -> bool:  # noqa: N802
        """Whether the move between two states is free."""
        self.n_checked += 1
        return self._is_free(_numbers(one, self._n), _numbers(other, self._n))


def search(
    start: FloatArray,
    end: FloatArray,
    limits: FloatArray,
    is_free: Callable[[FloatArray], bool],
    is_free_move: Callable[[FloatArray, FloatArray], bool],
) -> FloatArray | None:
    """Return the corners of a free path between free commands (n_actuated,) [m or rad]; None if none was found.

    It includes both ends, (n, n_actuated), and stays within the limits (n_actuated, 2).
    """
    n = len(start)
    space, bounds = base.RealVectorStateSpace(n), base.RealVectorBounds(n)
    for k, (low, high) in enumerate(limits):
        bounds.setLow(k, float(min(low, start[k], end[k])))
        bounds.setHigh(k, float(max(high, start[k], end[k])))
    space.setBounds(bounds)
    information = base.SpaceInformation(space)
    information.setStateValidityChecker(lambda state: is_free(_numbers(state, n)))
    validator = ProvenMotions(information, is_free_move, n)
    information.setMotionValidator(validator)
    information.setup()
    problem, ends = base.ProblemDefinition(information), (space.allocState(), space.allocState())
    for state, values in zip(ends, (start, end), strict=True):
        for k in range(n):
            state[k] = float(values[k])
    problem.setStartAndGoalStates(*ends)
    planner = geometric.RRTConnect(information)
    planner.setRange(_STEP * float(np.sqrt(n)))
    planner.setProblemDefinition(problem)
    planner.setup()
    solved = planner.solve(base.PlannerTerminationCondition(lambda: validator.n_checked >= _MOST_CHECKS))
    if not solved or not problem.hasExactSolution():
        return None
    path = problem.getSolutionPath()
    return np.array([_numbers(path.getState(k), n) for k in range(path.getStateCount())])


def _numbers(state: Any, n: int) -> FloatArray:
    return np.array([state[k] for k in range(n)])
