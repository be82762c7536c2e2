"""Every kind of measurement, by the name that robot descriptions use: the one place that knows them all."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Union

from pydantic import Field

from calib.observation.distance import Distance
from calib.observation.joint_reading import JointReading
from calib.observation.kind import Instrument
from calib.observation.orientation import Orientation
from calib.observation.pixel import Pixel
from calib.observation.pose import Pose
from calib.observation.position import Position
from calib.observation.touch import Touch
from calib.sections import Section

KINDS: dict[str, type[Instrument]] = {
    "position": Position,
    "pose": Pose,
    "orientation": Orientation,
    "joint_reading": JointReading,
    "pixel": Pixel,
    "distance": Distance,
    "touch": Touch,
}

if TYPE_CHECKING:
    AnyInstrument = Section
else:
    _sections = tuple(kind.section for kind in KINDS.values())
    AnyInstrument = Annotated[Union[_sections], Field(discriminator="kind")]  # noqa: UP007  # known when it runs
    """The entry of an instrument in a robot description."""
