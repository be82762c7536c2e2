"""What a fit found, by the names of parameters."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.arrays import BoolArray, FloatArray, ReadOnlyArrays
from calib.errors import InputError, nearest
from calib.numerics.statistics import Statistics, status
from calib.parameter import Parameter
from calib.words import data_frame, pandas, table_html


@dataclass(frozen=True)
class Estimate:
    """One parameter.

    Attributes:
        name: Its name.
        unit: Unit of its number in tables; the numbers here are SI.
        nominal: Value before [m or rad].
        value: Value found.
        std: Standard deviation; NaN where it was held.
        low95, high95: 95 % interval; NaN likewise.
        status: `identified`, `partly`, `prior`, `placed`, or `held`.
        family: Name of the coefficients that it belongs to, if their common size is found.
        per_si: How many of `unit` make one SI unit.
    """

    name: str
    unit: str
    nominal: float
    value: float
    std: float
    low95: float
    high95: float
    status: str
    family: str
    per_si: float

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval."""
        return self.low95, self.high95

    def row(self) -> dict[str, object]:
        """Return the row of a table, in `unit`."""
        numbers = ("nominal", "value", "std", "low95", "high95")
        scaled: dict[str, object] = {key: float(getattr(self, key)) * self.per_si for key in numbers}
        return {"name": self.name, "unit": self.unit, **scaled, "status": self.status}


class Estimates(Mapping[str, Estimate]):
    """All parameters of a fit, by name and in their order."""

    def __init__(self, found: Mapping[str, Estimate]) -> None:
        self._found = dict(found)

    def __getitem__(self, name: str) -> Estimate:
        if name not in self._found:
            raise InputError(f"no parameter '{name}'{nearest(name, self._found)}")
        return self._found[name]

    def __contains__(self, name: object) -> bool:
        return name in self._found

    def __iter__(self) -> Iterator[str]:
        return iter(self._found)

    def __len__(self) -> int:
        return len(self._found)

    def __repr__(self) -> str:
        return f"<{len(self)} estimates: {', '.join(list(self)[:5])}{', ...' if len(self) > 5 else ''}>"

    def rows(self) -> list[dict[str, object]]:
        """Return one row for each, in the units of tables."""
        return [one.row() for one in self.values()]

    def to_dataframe(self) -> Any:
        """Return a pandas table, in the units of tables; pandas missing is an `InputError`."""
        return data_frame(self.rows())

    def _repr_html_(self) -> str:
        return table_html(self.rows())


@dataclass(frozen=True, eq=False, repr=False)
class Covariance(ReadOnlyArrays):
    """Covariance of the free parameters, by name.

    Attributes:
        names: Of the free parameters, (n_free,).
        values: (n_free, n_free) [products of m and rad].
    """

    names: tuple[str, ...]
    values: FloatArray

    def __getitem__(self, pair: tuple[str, str]) -> float:
        for name in pair:
            if name not in self.names:
                raise InputError(f"no free parameter '{name}'{nearest(name, self.names)}")
        return float(self.values[self.names.index(pair[0]), self.names.index(pair[1])])

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.values, dtype=dtype)

    def __repr__(self) -> str:
        return f"<covariance of {len(self.names)} free parameters>"

    def to_dataframe(self) -> Any:
        """Return a pandas table [SI]; pandas missing is an `InputError`."""
        return pandas().DataFrame(self.values, index=self.names, columns=self.names)


def estimates(parameters: tuple[Parameter, ...], values: FloatArray, free: BoolArray, found: Statistics) -> Estimates:
    """Return what was found.

    Args:
        parameters: All parameters.
        values: Their values, (n_parameters,) [m or rad].
        free: Which were free, (n_parameters,).
        found: Uncertainty of the free ones.
    """
    uncertainty = iter(zip(found.std, found.half_width, found.data_share, strict=True))
    result = {}
    for one, value, use in zip(parameters, values, free, strict=True):
        std, half, share = next(uncertainty) if use else (np.nan, np.nan, np.nan)
        kind = status(share, std / one.sigma, prior=one.prior, placement=one.placement) if use else "held"
        result[one.name] = Estimate(
            one.name,
            one.unit,
            one.nominal,
            float(value),
            float(std),
            float(value - half),
            float(value + half),
            kind,
            one.family,
            one.per_si,
        )
    return Estimates(result)
