"""One number that may differ from its nominal value, as all packages use the word parameter."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, SupportsIndex, overload

import numpy as np

from calib.core.base.arrays import FloatArray, read_only
from calib.core.base.errors import ParameterError, nearest
from calib.core.base.other_words import hint_for
from calib.core.base.units import PER_SI, Dimension
from calib.core.base.words import data_frame


@dataclass(frozen=True)
class Parameter:
    """One number that may differ from its nominal value.

    Attributes:
        name: Unique name.
        dimension: Length or angle.
        nominal_si: Value in the description [m or rad].
        sigma_si: Expected deviation from nominal, one standard deviation [m or rad]; scales its column, and is its
            prior.
        unit: Unit of tables, and of every number here whose name does not end in `_si`.
        prior: Whether nominal +- sigma is a prior in a fit. False: the measurements alone decide.
        placement: Whether it only says where the measurement frame or a target is, which is no error of the robot.
        mean_si: Mean of its prior, if different from the nominal value [m or rad].
        family: Parameters of one family share a factor on their sigmas that is found from the data; empty: none.
    """

    name: str
    dimension: Dimension
    nominal_si: float
    sigma_si: float
    unit: str
    prior: bool = True
    placement: bool = False
    family: str = ""
    mean_si: float | None = None

    @property
    def expected_si(self) -> float:
        """Value that is expected before measuring [m or rad]."""
        return self.nominal_si if self.mean_si is None else self.mean_si

    @property
    def per_si(self) -> float:
        """Number of `unit` in one SI unit."""
        return PER_SI[self.dimension][self.unit]

    @property
    def nominal(self) -> float:
        """Value in the description, in `unit`."""
        return self.nominal_si * self.per_si

    @property
    def sigma(self) -> float:
        """Expected deviation from nominal, one standard deviation, in `unit`."""
        return self.sigma_si * self.per_si

    def row(self, value: float, free: bool) -> dict[str, object]:
        """Return the row of a table, in `unit`: with its present value [m or rad], and whether it is free, not held."""
        shown = {"nominal": self.nominal, "value": float(value) * self.per_si, "sigma": self.sigma}
        return {"name": self.name, "unit": self.unit, **shown, "free": "free" if free else "held"}


class Parameters(tuple[Parameter, ...]):
    """Parameters in their order; each is found by its number or its name."""

    def _own_parameters(self) -> list[str]:
        return [parameter.name for parameter in self]

    @overload
    def __getitem__(self, which: SupportsIndex | str) -> Parameter: ...
    @overload
    def __getitem__(self, which: slice) -> tuple[Parameter, ...]: ...
    def __getitem__(self, which: SupportsIndex | str | slice) -> Parameter | tuple[Parameter, ...]:
        return super().__getitem__(index_of(self, which) if isinstance(which, str) else which)

    def __reduce__(self) -> tuple[type[Parameters], tuple[tuple[Parameter, ...]]]:
        return type(self), (tuple(self),)  # without cached arrays, which would become writable

    def __contains__(self, which: object) -> bool:
        return super().__contains__(which) or any(parameter.name == which for parameter in self)

    @cached_property
    def expected_si(self) -> FloatArray:
        """Value of each that is expected before measuring, (n,) [m or rad]."""
        return read_only(np.array([parameter.expected_si for parameter in self]))

    @cached_property
    def sigma_si(self) -> FloatArray:
        """Expected deviation of each from nominal, one standard deviation, (n,) [m or rad]."""
        return read_only(np.array([parameter.sigma_si for parameter in self]))

    @cached_property
    def per_si(self) -> FloatArray:
        """Number of the unit of each in one SI unit, (n,)."""
        return read_only(np.array([parameter.per_si for parameter in self]))

    def places(self, names: Iterable[str], where: str = "parameters") -> list[int]:
        """Return the positions of these parameters; an unknown name is a `ParameterError`."""
        known = {parameter.name: place for place, parameter in enumerate(self)}
        return [known[name] if name in known else index_of(self, name, where) for name in names]

    def to_dataframe(self) -> Any:
        """Return nominal values and sigmas in units of tables; see `calib.core.base.words.pandas`."""
        keys = ("name", "unit", "nominal", "sigma")
        return data_frame([{key: getattr(parameter, key) for key in keys} for parameter in self])


def index_of(parameters: Sequence[Parameter], name: str, where: str = "parameters") -> int:
    """Return the position of a parameter; an unknown name is a `ParameterError` that names the nearest one."""
    for index, parameter in enumerate(parameters):
        if parameter.name == name:
            return index
    meant = hint_for(name, "names of parameters") or nearest(name, [parameter.name for parameter in parameters])
    raise ParameterError(f"{where}: no parameter '{name}'{meant}")
