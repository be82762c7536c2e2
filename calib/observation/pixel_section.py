"""What a robot description says of a camera and of the points that it sees."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationInfo, model_validator

from calib.errors import DescriptionError
from calib.observation.point_file import read_points
from calib.sections import Angle, Length, Section

_Positive = Annotated[float, Field(gt=0)]
_PositiveLength = Annotated[Length, Field(gt=0)]
_PositiveAngle = Annotated[Angle, Field(gt=0)]


class CameraSection(Section):
    """Where a camera stands: its optical frame, z along the optical axis, x to the right and y down in the image.

    Attributes:
        frame: Link that it is fixed to.
        xyz, rpy: Where it is in that link, and how it is turned [m], [rad].
        pose: `unknown`: found from the measurements; `known`: it is right there.
        sigma, sigma_angle: How far an unknown pose may be from these numbers [m], [rad]; left out, they say nothing.
    """

    frame: str
    xyz: tuple[Length, Length, Length] = (0.0, 0.0, 0.0)
    rpy: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    pose: Literal["known", "unknown"] = "unknown"
    sigma: _PositiveLength | None = None
    sigma_angle: _PositiveAngle | None = None

    @model_validator(mode="after")
    def _sigma_of_unknown(self) -> CameraSection:
        if self.pose == "known" and (self.sigma is not None or self.sigma_angle is not None):
            raise ValueError("sigma and sigma_angle are for a camera whose pose is unknown")
        return self


class IntrinsicsSection(Section):
    """Numbers of the camera model, as OpenCV calls them [px and pure numbers]."""

    fx: _Positive
    fy: _Positive
    cx: float
    cy: float
    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0


class UnknownIntrinsicsSection(Section):
    """How far intrinsics may be off; those that are left out are right."""

    fx: _Positive | None = None
    fy: _Positive | None = None
    cx: _Positive | None = None
    cy: _Positive | None = None
    k1: _Positive | None = None
    k2: _Positive | None = None
    p1: _Positive | None = None
    p2: _Positive | None = None
    k3: _Positive | None = None


class PixelSection(Section):
    """A camera that sees points of a target frame.

    Attributes:
        target: The frame of the body that carries the points.
        camera: Where the camera stands.
        intrinsics: The camera's model.
        unknown_intrinsics: How far intrinsics may be off that the measurements must find.
        points: Where each point is in the target frame, by name [m].
        points_file: A CSV file that says so, columns point, x, y, z; its path as seen from the description.
        image: Width and height [px]; points outside are not seen. Only predictions need it.
        columns: How the columns begin: `<columns>_u`, `<columns>_v`; the instrument's name if left out.
        sigma: Noise of a coordinate [px].
    """

    kind: Literal["pixel"]
    target: str
    camera: CameraSection
    intrinsics: IntrinsicsSection
    unknown_intrinsics: UnknownIntrinsicsSection | None = None
    points: dict[str, tuple[Length, Length, Length]] = Field(default_factory=dict)
    points_file: str | None = None
    image: tuple[_Positive, _Positive] | None = None
    columns: str | None = None
    sigma: _Positive | None = None

    @model_validator(mode="before")
    @classmethod
    def _from_file(cls, value: Any, info: ValidationInfo) -> Any:
        """Read the points of a file, so that it does not matter where they came from."""
        file = value.get("points_file") if isinstance(value, dict) else None
        if not isinstance(file, str):
            return value
        if "points" in value:
            raise ValueError("has points and points_file; leave one of them out")
        folder = (info.context or {}).get("folder", Path())
        try:
            rest = {key: entry for key, entry in value.items() if key != "points_file"}
            return {**rest, "points": read_points(folder / file)}
        except DescriptionError as error:
            raise ValueError(str(error)) from None

    @model_validator(mode="after")
    def _some_points(self) -> PixelSection:
        if not self.points:
            raise ValueError("needs points (name: [x, y, z]) or points_file")
        return self
