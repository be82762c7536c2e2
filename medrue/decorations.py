"""What the viewer shows around MedRUE: the target workspace, half a cylinder around a patient's leg."""

from medrue.workspace import target_workspace
from viz.decorations import half_cylinder
from viz.shapes import Shape

SKIN = (0.80, 0.62, 0.52, 0.28)


def leg() -> tuple[Shape, ...]:
    """Return the half cylinder on which the target workspace's positions lie, in the world frame [m]."""
    workspace = target_workspace()
    return (
        half_cylinder(
            "leg", workspace.p_axis, workspace.axis, workspace.middle, workspace.radius, workspace.length, SKIN
        ),
    )
