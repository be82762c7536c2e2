"""Checks of kinds of measurement and of joint terms: shapes, numbers and derivatives, for tests of their packages.

A wrong derivative does not stop a fit, which only converges more slowly, but its intervals are wrong. So each column is
compared with the central difference of the residuals, whose error is of second order in the step h, and of order
eps / h by rounding.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.core.base.arrays import FloatArray, IntArray
from calib.core.base.errors import ComputationError
from calib.core.instruments.kind import Comparison, Instrument, JointComparison, Readings, View
from calib.core.robots.terms.term import Condition, Context, JointTerm

_STEP = 1e-6  # m, rad; for unknown numbers relative to their expected error
_NEAR = 1e-5  # allowed difference of derivatives, as part of the largest of a row: rounding (1e-16 / 1e-6), lost digits
_SAME = 1e-6  # allowed difference of columns and formula of a term
_TWIST = ("dp_x", "dp_y", "dp_z", "dw_x", "dw_y", "dw_z")


def check_kind(
    instrument: Instrument,
    seen: View | FloatArray,
    unknowns: FloatArray | None = None,
    details: FloatArray | None = None,
) -> None:
    """Raise `ComputationError` where an instrument breaks the contract of its kind.

    Args:
        seen: n views in which it reads something; for a `JointInstrument`, values of the joint (n,) [m or rad].
        unknowns: Its unknown numbers, (n_unknowns,); nominal if not given.
        details: Details of readings, (n, n_details); none if not given.

    Raises:
        ComputationError: Shapes are wrong, a number is not finite, columns of a file do not lead back to the values, a
            residual of its own prediction is not zero, noise moves it otherwise than `with_errors` says, or a
            derivative is not that of the residuals.
    """
    n = len(seen.translation) if isinstance(seen, View) else len(seen)
    own = np.array([p.nominal_si for p in instrument.unknowns]) if unknowns is None else unknowns
    more = np.zeros((n, 0)) if details is None else details
    subject = f"{type(instrument).__qualname__} '{instrument.name}'"
    values = instrument.predict(seen, own, more)
    _require(
        np.ndim(values) == 2 and len(values) == n,
        f"{subject}: predict() returns shape {np.shape(values)}, not ({n}, n_values)",
    )
    _require(bool(np.isfinite(values).all()), f"{subject}: predict() returns numbers that are not finite")
    cells = instrument.cells(values)
    names = [column.name for column in instrument.columns()]
    _require(
        sorted(cells) == sorted(names),
        f"{subject}: cells() returns columns {sorted(cells)}, but columns() names {names}",
    )
    if names:
        again = instrument.values(cells)
        _require(
            np.allclose(again, values, rtol=1e-9, atol=1e-12), f"{subject}: values(cells(values)) are other values"
        )
    pairs: IntArray = np.zeros(n, dtype=np.intp)

    def compare(at: View | FloatArray, numbers: FloatArray, read: FloatArray) -> Comparison | JointComparison:
        return instrument.compare(at, numbers, Readings(np.arange(n), pairs, read, None, more))

    exact = compare(seen, own, values)
    by_seen = exact.by_twist if isinstance(exact, Comparison) else exact.by_joint[:, :, None]
    columns = _TWIST if isinstance(exact, Comparison) else ("joint",)
    for what, found, shape in (
        ("residuals", exact.residuals, (n, instrument.n_rows)),
        ("the derivative by what it sees", by_seen, (n, instrument.n_rows, len(columns))),
        ("by_unknown", exact.by_unknown, (n, instrument.n_rows, len(own))),
    ):
        _require(np.shape(found) == shape, f"{subject}: compare(): {what} of shape {np.shape(found)}, not {shape}")
        _require(bool(np.isfinite(found).all()), f"{subject}: compare(): {what} not finite")
    axes = [f"{part.name}.{axis}" for part in instrument.parts for axis in part.axes]
    _require(np.allclose(exact.residuals, 0, atol=1e-9), f"{subject}: residuals of its own predictions are not zero")
    noise = np.eye(instrument.n_rows) * _STEP
    for row, change in enumerate(noise):
        off = compare(seen, own, instrument.with_errors(values, np.tile(change, (n, 1)))).residuals
        _require(
            np.allclose(off, -change, atol=_NEAR * _STEP * 10),
            f"{subject}: with_errors() does not change row {axes[row]} alone by the given error",
        )
    for k, column in enumerate(columns):
        moved = (seen.after_step(k, h) if isinstance(seen, View) else seen + h for h in (_STEP, -_STEP))
        ends = [compare(at, own, values).residuals for at in moved]
        _require_same(
            by_seen[:, :, k], (ends[0] - ends[1]) / (2 * _STEP), by_seen, f"{subject}: derivative by {column}", axes
        )
    for k, parameter in enumerate(instrument.unknowns):
        step = np.where(np.arange(len(own)) == k, _STEP * max(parameter.sigma_si, _STEP), 0.0)
        ends = [compare(seen, own + sign * step, values).residuals for sign in (1, -1)]
        found = exact.by_unknown[:, :, k]
        _require_same(
            found, (ends[0] - ends[1]) / (2 * step[k]), found, f"{subject}: derivative by {parameter.name}", axes
        )


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
        _require(bool(np.all(off < _SAME)), f"{subject}: formula() and columns() give different values")
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


def _require_same(given: FloatArray, found: FloatArray, all_of_it: FloatArray, subject: str, axes: list[str]) -> None:
    """Raise `ComputationError` where derivatives (n, n_rows) differ by more than rounding."""
    off = np.abs(given - found) - _NEAR * max(float(np.max(np.abs(all_of_it), initial=0.0)), 1e-3)
    if np.max(off, initial=0.0) > 0:
        i, row = np.unravel_index(int(np.argmax(off)), off.shape)
        raise ComputationError(
            f"{subject}, row {axes[row]}, is {given[i, row]:.9g} at view {i + 1}, but central differences of the"
            f" residuals give {found[i, row]:.9g}"
        )


def _require(right: bool, message: str) -> None:
    if not right:
        raise ComputationError(message)
