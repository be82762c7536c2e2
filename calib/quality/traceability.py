"""The traceability of measurements in a robot description: the key `traceability`.

All of it is optional, and changes no fit: `calib certificate` computes an uncertainty budget from it, and
writes both. Free text is written as it is.
"""

from __future__ import annotations

import datetime
import re
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from calib.core.base.sections import Angle, Length, Pixels, Section

_RATIO = re.compile(r"^\s*([-+]?[\d.]+(?:[eE][-+]?\d+)?)\s*(um/m|ppm|mm/m|1)?\s*(/K)?\s*$")
_PER_ONE = {"": 1.0, "1": 1.0, "um/m": 1e6, "ppm": 1e6, "mm/m": 1e3}
_KELVIN = re.compile(r"^\s*([-+]?[\d.]+)\s*(?:K|degC|°C)?\s*$")
_RECTANGULAR = 3.0**0.5  # half width over standard uncertainty (GUM 4.3.7)


def _ratio(value: Any) -> Any:
    found = _RATIO.match(value) if isinstance(value, str) else None
    if found is None:
        if isinstance(value, str):
            raise ValueError(f"'{value:.60}' is not a ratio, such as '10 um/m' (expansion: '12 um/m/K')")
        return value
    return float(found.group(1)) / _PER_ONE[found.group(2) or ""]


def _kelvin(value: Any) -> Any:
    found = _KELVIN.match(value) if isinstance(value, str) else None
    if found is None and isinstance(value, str):
        raise ValueError(f"'{value:.60}' is not a temperature, such as '20 degC' (a difference: '1 K')")
    return value if found is None else float(found.group(1))


def _text(value: Any) -> Any:
    """Return a number or a date of YAML as text again."""
    return str(value) if isinstance(value, (int, float, datetime.date)) and not isinstance(value, bool) else value


Text = Annotated[str, BeforeValidator(_text, json_schema_input_type=str | float)]
Day = Annotated[Text, Field(pattern=r"^\d{4}-\d{2}-\d{2}$")]
_Finite = Field(ge=0, allow_inf_nan=False)
Ratio = Annotated[float, BeforeValidator(_ratio, json_schema_input_type=float | str), _Finite]
Temperature = Annotated[float, BeforeValidator(_kelvin, json_schema_input_type=float | str), Field(allow_inf_nan=False)]
_Difference = Annotated[Temperature, Field(ge=0)]
_NotNegative = Annotated[Length, Field(ge=0)]


class ItemSection(Section):
    """The robot that is calibrated, as free text."""

    maker: Text | None = None
    type: Text | None = None
    serial: Text | None = None


class CertifiedInstrumentSection(ItemSection):
    """An instrument, and the error that its calibration certificate allows, the same in all readings.

    Attributes:
        certificate, date, laboratory: Those of its own calibration.
        scale: How far lengths may be off, relative.
        offset: How far positions may be off along each axis, or distances [m].
        offset_angle: How far angles may be off, about each axis of orientations [rad].
        focal_length: How far the focal length of a camera may be off, relative.
        principal_point: How far the principal point of a camera may be off along each axis [px].
        stated: Whether these are expanded uncertainties, or maximum permissible errors (limits, rectangular).
        k: Coverage factor of expanded uncertainties.
    """

    certificate: Text | None = None
    date: Day | None = None
    laboratory: Text | None = None
    scale: Ratio = 0.0
    offset: _NotNegative = 0.0
    offset_angle: Annotated[Angle, Field(ge=0)] = 0.0
    focal_length: Ratio = 0.0
    principal_point: Annotated[Pixels, Field(ge=0)] = 0.0
    stated: Literal["expanded", "maximum permissible error"] = "expanded"
    k: Annotated[float, Field(ge=1, allow_inf_nan=False)] = 2.0

    @property
    def divisor(self) -> float:
        """Stated number over standard uncertainty."""
        return self.k if self.stated == "expanded" else _RECTANGULAR


class ReflectorSection(Section):
    """The target that is read.

    Attributes:
        diameter: Its diameter [m].
        centring: Standard uncertainty of the place of its centre, with an independent error at each reading [m].
    """

    diameter: _NotNegative | None = None
    centring: _NotNegative = 0.0


class TemperatureSection(Section):
    """Temperatures of the robot.

    Attributes:
        calibration, use: Mean temperatures [degC].
        uncertainty: Standard uncertainty of their difference [K].
        expansion: Coefficient of the robot's lengths [1/K].
        expansion_uncertainty: Standard uncertainty of the coefficient [1/K].
    """

    calibration: Temperature | None = None
    use: Temperature | None = None
    uncertainty: _Difference = 0.0
    expansion: Ratio = 0.0
    expansion_uncertainty: Ratio = 0.0

    @property
    def difference(self) -> float:
        """Temperature of use minus that of calibration [K]; 0 where either is not stated."""
        return 0.0 if self.use is None or self.calibration is None else self.use - self.calibration


class TraceabilitySection(Section):
    """The whole key `traceability`; see docs/howto/certificate.md.

    Attributes:
        date: Day of the measurements, ISO 8601.
        country: Country of the laboratory, two letters of ISO 3166-1.
    """

    date: Day | None = None
    country: Annotated[str, Field(pattern="^[A-Z]{2}$")] | None = None
    laboratory: Text | None = None
    operator: Text | None = None
    site: Text | None = None
    customer: Text | None = None
    item: ItemSection = ItemSection()
    instrument: CertifiedInstrumentSection = CertifiedInstrumentSection()
    target: ReflectorSection = ReflectorSection()
    temperature: TemperatureSection = TemperatureSection()
