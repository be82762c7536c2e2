"""Every kind of measurement, by the name that robot descriptions use: the one place that knows them all."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Union

from pydantic import Field

from calib.base.sections import Section
from calib.instruments.distance import Distance
from calib.instruments.joint_reading import JointReading
from calib.instruments.kind import Instrument
from calib.instruments.orientation import Orientation
from calib.instruments.pixel import Pixel
from calib.instruments.pose import Pose
from calib.instruments.position import Position
from calib.instruments.touch import Touch

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
