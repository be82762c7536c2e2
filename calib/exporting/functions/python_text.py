"""A robot's functions as a Python file: facts as numbers, and code for numpy, jax, torch or casadi.

numpy, jax and torch share the code except for a few lines each; casadi has its own.
"""

from __future__ import annotations

import pprint
from collections.abc import Sequence
from typing import Any

import numpy as np

from calib.exporting.functions.facts import SOURCES, Gravity, RobotFacts, header_lines, template
from calib.exporting.functions.trees import FunctionTree

_OF_LIBRARY: dict[str, tuple[str, ...]] = {
    "numpy": (),
    "jax": (
        "",
        "Importing this switches jax to double precision. Derivatives are exact up to the third order, in closed loops",
        "too. `forward` and `jacobian` are compiled, once for each shape of q.",
    ),
    "casadi": (
        "",
        "Both take MX symbols or numbers. Derivatives are exact up to the third order, in closed loops too.",
    ),
    "torch": ("", "Computes in double precision. Derivatives are exact up to the third order, in closed loops too."),
}


def python_text(facts: RobotFacts, library: str, lines: Sequence[str]) -> str:
    """Return the Python file of a robot for a library; `lines` are comments on the origin of the numbers."""
    parts = [_docstring(facts, library, lines), template(f"python_{library}"), _numbers(facts)]
    if library == "casadi":
        return "".join([*parts, template("casadi_code")])
    parts += [template("python_core"), template("python_doors")]
    if library == "numpy":
        parts.append(template("python_inverse"))
    return "".join(parts)


def _docstring(facts: RobotFacts, library: str, lines: Sequence[str]) -> str:
    functions = ["forward(q)", "jacobian(q)", *(["inverse(poses, start)"] if library == "numpy" else [])]
    text = [
        *header_lines(facts, lines, "BASE"),
        "",
        f"{', '.join(functions)} take one pose, or batches of any shape; q is (..., {len(facts.robot.joint_names)}).",
    ]
    if facts.conditions:
        text += ["", "Joint errors depend on conditions, which these functions take by name:"]
        given = facts.conditions.items()
        text += [f"    {name}: {meaning}; {neutral:g} if not given" for name, (neutral, meaning) in given]
    body = "\n".join([*text, *_OF_LIBRARY[library]])
    return '"""' + body.replace("\\", "\\\\").replace('"', "'") + '\n"""\n\n'


def _numbers(facts: RobotFacts) -> str:
    entries: dict[str, Any] = {
        "JOINTS": facts.robot.joint_names,
        "UNITS": facts.units,
        "TOOLS": facts.robot.target_names,
        "CONDITIONS": {name: neutral for name, (neutral, _) in facts.conditions.items()},
        "LOWER": facts.lower,
        "UPPER": facts.upper,
        "HOME": facts.home,
        "BASE": facts.base,
        "_LENGTH": facts.robot.mechanism.length,
        "_TURN": 2.0 * np.pi,
        "_WORLD": np.eye(4, 3),
        "_WORLD_ROW": np.eye(4)[3:],
        "_SHARES": [(share.driven, SOURCES[share.source], *share[2:]) for share in facts.shares],
        "_WAVES": facts.waves,
        "_GRAVITY": None if facts.gravity is None else _gravity(facts.gravity),
        "_ROBOT": _tree(facts.tree),
    }
    lines = [f"{name} = {_literal(value)}\n" for name, value in entries.items()]
    return "".join(['\n\ninf = float("inf")\n', *lines])


def _gravity(gravity: Gravity) -> dict[str, Any]:
    return {
        "tree": _tree(gravity.tree),
        "masses": gravity.masses,
        "moments": gravity.moments,
        "payload": gravity.payload,
        "behind": gravity.tree.behind.astype(float),
        "acceleration": gravity.acceleration,
    }


def _tree(tree: FunctionTree) -> dict[str, Any]:
    return {
        "n_driven": tree.n_driven,
        "joints": tree.joints,
        "frames": tree.frames,
        "closures": [(a, b) for a, b, _ in tree.closures],
        "rows": [3 * k + row for k, (_, _, rows) in enumerate(tree.closures) for row in rows],
        "follows": tree.follows,
        "order": _order(tree),
        "scale": tree.scale,
        "starts": tree.starts.T if tree.closures else (),
        "blocks": [(*block, float(sign)) for block, sign in zip(tree.blocks, tree.signs, strict=True)],
        "limits": tree.limits,
        "tolerance": tree.tolerance,
    }


def _order(tree: FunctionTree) -> list[int] | None:
    """Index of the joint of each element of x; None if some element is no joint's value."""
    order = {joint.coordinate: k for k, joint in enumerate(tree.joints) if joint.factor == 1.0}
    return [order[k] for k in range(len(order))] if len(tree.scale) == len(order) == len(tree.joints) else None


def _literal(value: Any) -> str:
    return pprint.pformat(_plain(value), width=118, compact=True, sort_dicts=False)


def _plain(value: Any) -> Any:
    """Arrays and lists as tuples of Python's own numbers, without negative zeros."""
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return tuple(_plain(item) for item in value)
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return value + 0.0 if isinstance(value, float) else value
