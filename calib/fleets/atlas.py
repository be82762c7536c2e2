"""Priors of known models, such as those of the folder `models`, and robots with them.

`calib fleet` makes each from the maker's own calibrations of several robots of a type, as published by their owners
(files of `ur_calibration`): mean and spread of the joint origins, and the uncertainty of the mean. The stock URDF from
the maker's published Denavit-Hartenberg parameters is beside it. The first lines of a file state the number of robots.
"""

from __future__ import annotations

from pathlib import Path

from calib.core.base.errors import DescriptionError, nearest
from calib.core.base.registry import load_group
from calib.core.robots.loading import build, load
from calib.core.robots.robot import Robot

MODELS = {path.stem: path for path in sorted((Path(__file__).parent / "models").glob("*.yaml"))}
"""The files, by the model's name."""
_SAME_ORIGIN = 1e-4
"""Difference that rounding may leave between the origins of a stock URDF and of its model [m or 1]."""


def with_model(robot: Robot, model: str) -> Robot:
    """Return a robot with the prior of its model (`calib.core.robots.fleet_prior`).

    Args:
        robot: Not calibrated yet; names of its joints may have a prefix before those of the model.
        model: Name of a model that a capability or another package brings, such as `ur5e`; or the file that `calib
            fleet` wrote, beside the robot's description.

    Raises:
        DescriptionError: No such model, or the robot is not of it.
    """
    known = {name: path for _, given in load_group("calib.models", "model") for name, path in given.items()}
    if model not in known and Path(model).suffix.lower() not in (".yaml", ".yml"):
        raise DescriptionError(
            f"{robot.path}: model: no model '{model}'{nearest(model, known)}; or give a file that calib fleet wrote"
        )
    of_model = load(known.get(model, Path(robot.path).parent / model))
    section, joints = of_model.description.fleet, of_model.joint_names
    if section is None:
        raise DescriptionError(f"{model}: has no key 'fleet'; calib fleet writes it")
    prefix = next((name.removesuffix(joints[0]) for name in robot.joint_names if name.endswith(joints[0])), "")
    for name in joints:
        place = robot.nominal.placement(prefix + name) if prefix + name in robot.nominal.origin_names else None
        if place is None or not place.isApprox(of_model.nominal.placement(name), _SAME_ORIGIN):
            raise DescriptionError(
                f"{robot.path}: is not the stock robot '{model}': joint '{prefix + name}' is "
                + ("missing" if place is None else "elsewhere in that model; give the stock URDF")
            )
    own = {p.name for p in robot.parameters}
    entries = {prefix + name: entry for name, entry in section.parameters.items() if prefix + name in own}
    if not entries:
        raise DescriptionError(f"{robot.path}: none of the joint origins that '{model}' knows is free")
    fleet = section.model_copy(update={"parameters": entries, "unlike": ()})
    return build(robot.description.model_copy(update={"fleet": fleet}), robot.urdf, robot.path)
