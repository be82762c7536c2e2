"""Every kind of measurement, by its name in robot descriptions.

Entry points of the group `calib.kinds`, or `KINDS.register` in Python, add kinds of other packages.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from calib.core.base.registry import Registry, entry
from calib.core.instruments.distance import Distance
from calib.core.instruments.joint_reading import JointReading
from calib.core.instruments.kind import Instrument, InstrumentSection
from calib.core.instruments.orientation import Orientation
from calib.core.instruments.pixel import Pixel
from calib.core.instruments.pose import Pose
from calib.core.instruments.position import Position
from calib.core.instruments.touch import Touch

KINDS: Registry[Instrument] = Registry(
    "kind of measurement",
    "calib.kinds",
    Instrument,  # type: ignore[type-abstract]
    {
        "position": Position,
        "pose": Pose,
        "orientation": Orientation,
        "joint_reading": JointReading,
        "pixel": Pixel,
        "distance": Distance,
        "touch": Touch,
    },
)

if TYPE_CHECKING:
    AnyInstrument = InstrumentSection
else:
    AnyInstrument = Annotated[InstrumentSection, *entry("kind", KINDS)]
    """The entry of an instrument in a robot description."""
