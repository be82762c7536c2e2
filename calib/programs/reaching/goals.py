"""Goals of the inverse kinematics, and their CSV files.

Columns, with units as everywhere: `<target>_x`, `_y`, `_z` (position in the measurement frame). For an orientation also
`<target>_rx`, `_ry`, `_rz` (roll, pitch, yaw about fixed axes, as URDF's rpy, of the target's link), or for a direction
`<target>_ax`, `_ay`, `_az` (the z axis of the target's link; any length). A column `pose` names the rows. Columns
`load`, `temperature`, `time`, `setup`, `approach_<joint>` and those of gravity are the conditions at the goal. Columns
of inclinometers or of their joints are the values of these joints. A coordinate with an empty cell is free: a robot
that moves in a plane cannot choose its height.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from calib.core.base.arrays import FloatArray, IntArray
from calib.core.base.errors import DataError
from calib.core.data.instrument_cells import setups_of
from calib.core.data.table_poses import conditions_of_table, stands_of_table
from calib.core.data.tables import Table, read_table
from calib.core.robots.robot import Robot
from calib.core.robots.terms.term import Context


@dataclass(frozen=True, eq=False)
class Goals:
    """Goals for a target, in the measurement frame.

    Attributes:
        positions: (n, 3) [m]; NaN for free coordinates.
        rotations: Orientation of the target's link, (n, 3, 3), or None.
        directions: Direction of the z axis of the target's link, (n, 3), or None; normalised.
        names: Pose name of each; default: a running number.
        labels: Name of each in messages.
        target: Name of the measured point; default: the robot's first.
        context: Conditions as in `Poses`, (n,) [SI] by name.
        approach: Direction from which each joint comes, +1 or -1, (n, n_actuated); None: unknown.
        setups: Index of the setup whose direction of gravity applies, (n,); None: the first.
        stands: Values of the joints that inclinometers read, by name, (n,) or one number [rad].
    """

    positions: FloatArray
    rotations: FloatArray | None = None
    directions: FloatArray | None = None
    names: tuple[str, ...] = field(default=())
    labels: tuple[str, ...] = field(default=())
    target: str = ""
    context: Mapping[str, FloatArray] = field(default_factory=dict)
    approach: FloatArray | None = None
    setups: IntArray | None = None
    stands: Mapping[str, ArrayLike] = field(default_factory=dict)

    def __post_init__(self) -> None:
        n = len(self.positions)
        if self.rotations is not None and self.directions is not None:
            raise DataError("goals: give an orientation or a direction, not both")
        object.__setattr__(self, "names", tuple(self.names) or tuple(str(k + 1) for k in range(n)))
        object.__setattr__(self, "labels", tuple(self.labels) or tuple(f"goal {name}" for name in self.names))
        if len(self.names) != n or len(self.labels) != n:
            raise DataError(f"goals: {len(self.names)} names and {len(self.labels)} labels for {n} positions")
        object.__setattr__(self, "stands", {name: self._stand(name, value) for name, value in self.stands.items()})
        for key, shape in (("positions", (n, 3)), ("rotations", (n, 3, 3)), ("directions", (n, 3))):
            self._keep(key, shape)
        if self.rotations is not None:
            _require_rotations(self.rotations, self.labels)
        if self.directions is not None:
            lengths = np.linalg.norm(self.directions, axis=1, keepdims=True)
            if np.any(lengths < 1e-9):
                raise DataError(f"{self.labels[int(np.argmin(lengths))]}: the direction has no length")
            object.__setattr__(self, "directions", self.directions / lengths)

    def _stand(self, name: str, value: ArrayLike) -> FloatArray:
        values = np.asarray(value, dtype=float)
        if values.shape not in ((), (len(self.positions),)) or not np.all(np.isfinite(values)):
            raise DataError(f"goals: stands of '{name}' must be one number [rad], or one for each of the goals")
        return np.broadcast_to(values, len(self.positions))

    def _keep(self, key: str, shape: tuple[int, ...]) -> None:
        """Replace a field by a checked copy."""
        if getattr(self, key) is None:
            return
        values = np.array(getattr(self, key), dtype=float)
        if values.shape != shape:
            raise DataError(f"goals: {key} of shape {values.shape}; expected {shape}")
        stated = np.isfinite(values)
        if key == "positions":
            stated |= np.isnan(values) & stated.any(axis=1, keepdims=True)
        finite = stated.all(axis=tuple(range(1, values.ndim)))
        if not finite.all():
            raise DataError(f"{self.labels[int(np.argmin(finite))]}: {key} are not finite")
        object.__setattr__(self, key, values)

    def __len__(self) -> int:
        return len(self.positions)

    def subset(self, index: IntArray) -> Goals:
        """Return the goals with these indices (n,), in this order."""
        arrays = ("positions", "rotations", "directions", "approach", "setups")
        given = {key: getattr(self, key)[index] for key in arrays if getattr(self, key) is not None}
        given |= {key: tuple(getattr(self, key)[k] for k in index) for key in ("names", "labels")}
        for key in ("context", "stands"):
            given[key] = {name: values[index] for name, values in getattr(self, key).items()}
        return replace(self, **given)

    def conditions(self, n_actuated: int) -> Context:
        """Return the conditions at the goals, for a robot with `n_actuated` motors."""
        approach = np.zeros((len(self), n_actuated)) if self.approach is None else self.approach
        return Context.from_conditions(approach, self.context, self.setups)

    def distances(self, positions: FloatArray, index: IntArray | slice = slice(None)) -> FloatArray:
        """Return positions (n, 3) minus those of the goals `index`, 0 for free coordinates, (n, 3) [m]."""
        goals = self.positions[index]
        return np.where(np.isnan(goals), 0.0, positions - goals)

    @property
    def asks_for(self) -> str:
        """Kind of the goals: `full pose`, `position and axis` or `position`."""
        if self.rotations is not None:
            return "full pose"
        return "position" if self.directions is None else "position and axis"


def goals_of_poses(poses: ArrayLike) -> Goals:
    """Return poses (n, 4, 4) or (4, 4) [m], as `Robot.forward` gives them for the target, as goals."""
    values = np.asarray(poses, dtype=float).reshape(-1, 4, 4)
    return Goals(values[:, :3, 3], rotations=values[:, :3, :3])


def read_goals(path: Path | str, robot: Robot) -> Goals:
    """Read goals for one of the robot's targets; see the module docstring for the columns.

    Raises:
        DataError: The message names file, line and column.
    """
    table = read_table(path, robot.description.columns)
    target = _target(table, robot)
    positions = np.stack([table.column(f"{target}_{axis}", "length", gaps=True) for axis in "xyz"], axis=1)
    turned, pointed = ([f"{kind}{axis}" for axis in "xyz" if f"{target}_{kind}{axis}" in table.names] for kind in "ra")
    if turned and pointed:
        raise DataError(
            f"{path}: columns {target}_{turned[0]} and {target}_{pointed[0]} exclude each other; give an"
            " orientation (rx, ry, rz) or a direction of the z axis (ax, ay, az)"
        )
    rotations = directions = None
    if turned:
        angles = np.stack([table.column(f"{target}_r{axis}", "angle") for axis in "xyz"], axis=1)
        rotations = np.array([pin.rpy.rpyToMatrix(*angle) for angle in angles])
    if pointed:
        directions = np.stack([_pure_numbers(table, f"{target}_{axis}") for axis in ("ax", "ay", "az")], axis=1)
    names = tuple(table.text("pose")) if "pose" in table.names else tuple(str(k + 1) for k in range(len(table.rows)))
    labels = tuple(
        f"{table.path}, line {line}" + (f" (pose {name})" if "pose" in table.names else "")
        for line, name in zip(table.lines, names, strict=True)
    )
    setups = _setups(table, robot)
    conditions = conditions_of_table(table, robot)
    stands = stands_of_table(table, robot, setups)
    return Goals(positions, rotations, directions, names, labels, target, *conditions, setups, stands)


def _setups(table: Table, robot: Robot) -> IntArray | None:
    """The setup of each row, for its direction of gravity; `DataError` for a setup that moves base or targets."""
    of_setups = robot.description.setups
    if not of_setups or "setup" not in table.names:
        return None
    setups = setups_of(robot, table)
    names = list(of_setups)
    moved = [k for k, name in enumerate(names) if any(of_setups[earlier] for earlier in names[1 : k + 1])]
    wrong = np.flatnonzero(np.isin(setups, moved))
    if len(wrong):
        raise DataError(
            f"{table.path}, line {table.lines[wrong[0]]}, column 'setup': goals are in the frame of the first setup"
            f" '{names[0]}', and something was moved before '{names[setups[wrong[0]]]}'; give goals in the first frame,"
            " without this column, and a description with gravity.down of the later setup"
        )
    return setups


def _target(table: Table, robot: Robot) -> str:
    """The only target with position columns in the file."""
    named = [target for target in robot.target_names if any(f"{target}_{axis}" in table.names for axis in "xyz")]
    if len(named) > 1:
        raise DataError(f"{table.path}: columns for targets {', '.join(named)}; give the goals of one target per file")
    if not named:
        expected = " or ".join(f"{target}_x, {target}_y, {target}_z" for target in robot.target_names)
        raise DataError(f"{table.path}: no position columns; expected {expected} (found {', '.join(table.names)})")
    return named[0]


def _pure_numbers(table: Table, name: str) -> FloatArray:
    if name in table.names and table.units[table.names.index(name)]:
        raise DataError(f"{table.path}, column '{name}': a direction has no unit; write '{name}' alone")
    return table.column(name, "length")


def _require_rotations(rotations: FloatArray, labels: tuple[str, ...]) -> None:
    skew = np.abs(rotations @ rotations.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    wrong = (skew > 1e-6) | (np.linalg.det(rotations) < 0)
    if wrong.any():
        raise DataError(f"{labels[int(np.argmax(wrong))]}: the orientation is not a rotation matrix")
