"""A check of a joint term for its package's tests: shapes, numbers, derivatives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import ComputationError
from calib.core.robots.terms.term import Condition, Context, JointTerm

_NEAR = 1e-6


def check_term(term: JointTerm, q: FloatArray, j: int, context: Context) -> None:
    """Raise `ComputationError` if a term does not keep what its class promises.

    Args:
        q: Commands that show it, (n, n_actuated) [m or rad].
        j: Place of its joint among the actuated ones.
        context: Conditions that show it; also the torque, if the term needs it.

    Raises:
        ComputationError: Columns have a wrong shape, are not finite, do not change with a condition of `depends_on`, or
            are not those of the formula; or `torque_derivative` is not that of the columns.
    """
    subject, shape = type(term).__qualname__, (len(q), len(term.parameters))
    columns = term.columns(q, j, context)
    _require(np.shape(columns) == shape, f"{subject}: columns() returns shape {np.shape(columns)}, not {shape}")
    _require(bool(np.isfinite(columns).all()), f"{subject}: columns() returns numbers that are not finite")
    _require(bool(np.any(columns)), f"{subject}: columns() returns only zeros at these commands")
    formula = term.formula(j)
    if formula is not None:
        off = np.abs(formula.columns(context.inputs(q)) - columns)
        _require(bool(np.all(off < _NEAR)), f"{subject}: formula() and columns() give different values")
    for condition in term.depends_on:
        by_torque = condition == Condition.LOAD and term.needs_torque  # the torque contains the load
        less = None if by_torque else _without(context, condition)
        changes = less is None or not np.array_equal(term.columns(q, j, less), columns)
        _require(changes, f"{subject}: says that it depends on {condition.words}, but columns() ignores it")
    if term.needs_torque and context.torque is not None:
        rate = np.ones_like(context.torque)
        step = 1e-6 * max(float(np.max(np.abs(context.torque))), 1.0)
        ends = [term.columns(q, j, replace(context, torque=context.torque + s * rate)) for s in (step, -step)]
        off = np.abs(term.torque_derivative(q, j, context, rate) - (ends[0] - ends[1]) / (2 * step))
        _require(
            bool(np.all(off < 1e-4 * max(float(np.max(np.abs(columns))), 1.0))),
            f"{subject}: torque_derivative is wrong",
        )


def _without(context: Context, condition: Condition) -> Context | None:
    """The conditions without one of them; None if it is not among them."""
    if condition == Condition.APPROACH:
        return replace(context, approach=np.zeros_like(context.approach))
    if condition.column in ("time", "temperature", "load"):
        return replace(context, **{condition.column: np.zeros_like(context.time)})  # type: ignore[arg-type]
    if condition.column:
        return replace(context, others={k: v for k, v in context.others.items() if k != condition.column})
    return None


def _require(right: bool, message: str) -> None:
    if not right:
        raise ComputationError(message)
