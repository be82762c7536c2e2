"""Origins under the names and signs of a trade: a table of terms, each an angle of one joint origin."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import DescriptionError
from calib.core.base.parameter import Parameter
from calib.core.base.sections import COMPONENTS, Component
from calib.core.robots.parameters import Origin, OriginComponents


@dataclass(frozen=True)
class NamedComponent:
    """A component of an origin under another name.

    Attributes:
        name: Name in the trade.
        origin, component: The component.
        sign: +1, or -1 where the trade counts the other way.
        sigma: Expected error [m or rad].
        unit: Unit of tables.
    """

    name: str
    origin: str
    component: Component
    sign: int
    sigma: float
    unit: str


@dataclass(frozen=True, eq=False)
class NamedOrigins:
    """A parametrisation by such components, each a deviation from nominal origins."""

    components: tuple[NamedComponent, ...]
    origins: Mapping[str, Origin]

    def __post_init__(self) -> None:
        missing = next((each.origin for each in self.components if each.origin not in self.origins), None)
        if missing is not None:
            raise DescriptionError(f"the URDF has no joint '{missing}', which the parametrisation needs")

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The components."""
        return tuple(
            Parameter(each.name, "length" if len(each.component) == 1 else "angle", 0.0, each.sigma, each.unit)
            for each in self.components
        )

    @cached_property
    def _plain(self) -> OriginComponents:
        places = tuple((each.origin, COMPONENTS.index(each.component)) for each in self.components)
        return OriginComponents(self.parameters, places, {name: self.origins[name].placement for name, _ in places})

    @property
    def _signs(self) -> FloatArray:
        return np.array([float(each.sign) for each in self.components])

    def placements(self, values: FloatArray) -> dict[str, pin.SE3]:
        """Return the origins; see `calib.core.robots.parameters.Parametrisation`."""
        return self._plain.placements(self._signs * values)

    def twists(self, values: FloatArray) -> dict[str, FloatArray]:
        """Return derivatives of the origins; see `calib.core.robots.parameters.Parametrisation`."""
        return {name: twist * self._signs for name, twist in self._plain.twists(self._signs * values).items()}
