"""The parameters found by a fit, by name."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, ValuesView
from dataclasses import dataclass
from typing import Any, SupportsFloat

import numpy as np
from numpy.typing import NDArray

from calib.core.base.arrays import BoolArray, FloatArray, ReadOnlyArrays
from calib.core.base.contributions import Contributions
from calib.core.base.errors import InputError, nearest
from calib.core.base.parameter import Parameters
from calib.core.base.words import data_frame, pandas, table_html
from calib.core.numerics.statistics import Statistics, status

NUMBERS = ("nominal", "value", "std", "low95", "high95")
"""Columns of tables of parameters, in the parameter's unit."""


@dataclass(frozen=True)
class HalfWidth:
    """Half the 95 % interval of free parameter number `place`, computed at first use."""

    statistics: Statistics
    place: int

    def __float__(self) -> float:
        return float(self.statistics.half_width[self.place])


@dataclass(frozen=True)
class Estimate:
    """One parameter: numbers in `unit`, and in m or rad where their name ends in `_si`.

    Attributes:
        unit: Unit of tables.
        nominal_si: Value before calibration [m or rad].
        std_si: Standard deviation; NaN where it was held.
        half95_si: Half the 95 % interval; NaN where it was held.
        status: `identified`, `partly`, `prior`, `weak`, `placed`, or `held`.
        family: Name of the family of its coefficients, if their common size is found.
        per_si: Number of `unit` in one SI unit.
    """

    name: str
    unit: str
    nominal_si: float
    value_si: float
    std_si: float
    half95_si: SupportsFloat
    status: str
    family: str
    per_si: float

    @property
    def nominal(self) -> float:
        """Value before calibration, in `unit`."""
        return self.nominal_si * self.per_si

    @property
    def value(self) -> float:
        """Calibrated value, in `unit`."""
        return self.value_si * self.per_si

    @property
    def std(self) -> float:
        """Standard deviation, in `unit`; NaN where it was held."""
        return self.std_si * self.per_si

    @property
    def low95_si(self) -> float:
        """Lower end of the 95 % interval [m or rad]; NaN where it was held."""
        return self.value_si - float(self.half95_si)

    @property
    def high95_si(self) -> float:
        """Upper end of the 95 % interval [m or rad]; NaN where it was held."""
        return self.value_si + float(self.half95_si)

    @property
    def low95(self) -> float:
        """Lower end of the 95 % interval, in `unit`; NaN where it was held."""
        return self.low95_si * self.per_si

    @property
    def high95(self) -> float:
        """Upper end of the 95 % interval, in `unit`; NaN where it was held."""
        return self.high95_si * self.per_si

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval, in `unit`."""
        return self.low95, self.high95

    def __str__(self) -> str:
        return f"{self.name} = {self.value:.6g} {self.unit} (std {self.std:.3g} {self.unit}), {self.status}"

    def row(self) -> dict[str, object]:
        """Return the row of a table, in `unit`."""
        numbers: dict[str, object] = {key: getattr(self, key) for key in NUMBERS}
        return {"name": self.name, "unit": self.unit, **numbers, "status": self.status}


class Estimates(Mapping[str, Estimate]):
    """All parameters of a fit, by name and in their order.

    Args:
        contains: Contributions to their intervals; none where these are not known.
    """

    def __init__(self, by_name: Mapping[str, Estimate], contains: Contributions = frozenset()) -> None:
        self._by_name, self.contains = dict(by_name), contains

    def _own_parameters(self) -> list[str]:
        return list(self)

    def __getitem__(self, name: str) -> Estimate:
        if name not in self._by_name:
            raise InputError(f"no parameter '{name}'{nearest(name, self._by_name)}")
        return self._by_name[name]

    def __contains__(self, name: object) -> bool:
        return name in self._by_name

    def __iter__(self) -> Iterator[str]:
        return iter(self._by_name)

    def __len__(self) -> int:
        return len(self._by_name)

    def __repr__(self) -> str:
        return f"<{len(self)} estimates: {', '.join(list(self)[:5])}{', ...' if len(self) > 5 else ''}>"

    def values(self) -> ValuesView[Estimate]:
        """Return the parameters in their order."""
        return self._by_name.values()

    def rows(self) -> list[dict[str, object]]:
        """Return one row for each, in the units of tables."""
        return [estimate.row() for estimate in self.values()]

    def to_dataframe(self) -> Any:
        """Return a pandas table, in the units of tables; pandas missing is an `InputError`."""
        return data_frame(self.rows())

    def _repr_html_(self) -> str:
        return table_html(self.rows())


@dataclass(frozen=True, eq=False, repr=False)
class Covariance(ReadOnlyArrays):
    """Covariance of the free parameters, by name.

    Attributes:
        names: Names of the free parameters, (n_free,).
        values: (n_free, n_free) [products of m and rad].
        contains: Contributions to it; none where these are not known.
    """

    names: tuple[str, ...]
    values: FloatArray
    contains: Contributions = frozenset()

    def __getitem__(self, pair: tuple[str, str]) -> float:
        if not isinstance(pair, tuple) or len(pair) != 2:
            raise InputError(f"{type(self).__name__}: takes two names, such as [{pair!r:.40}, {self.names[-1]!r}]")
        for name in pair:
            if name not in self.names:
                raise InputError(f"no free parameter '{name}'{nearest(name, self.names)}")
        return float(self.values[self.names.index(pair[0]), self.names.index(pair[1])])

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.values, dtype=dtype)

    def __repr__(self) -> str:
        return f"<{type(self).__name__.lower()} of {len(self.names)} free parameters>"

    @property
    def correlation(self) -> Correlation:
        """Correlations: the covariances over both standard deviations; NaN without scatter."""
        std = np.sqrt(np.diagonal(self.values))
        with np.errstate(divide="ignore", invalid="ignore"):
            unit = self.values / std / std[:, None]
        return Correlation(self.names, np.clip(unit, -1.0, 1.0), self.contains)

    def to_dataframe(self) -> Any:
        """Return a pandas table; pandas missing is an `InputError`."""
        return pandas().DataFrame(self.values, index=self.names, columns=self.names)


class Correlation(Covariance):
    """Correlation of the free parameters, by name: numbers between -1 and 1 instead of the products."""


def estimates(parameters: Parameters, values: FloatArray, free: BoolArray, statistics: Statistics) -> Estimates:
    """Return the estimates of all parameters.

    Args:
        values: Their values, (n_parameters,) [m or rad].
        free: Mask of the free parameters, (n_parameters,).
    """
    kinds = np.array([(parameter.prior, parameter.placement) for parameter in parameters], dtype=bool).reshape(-1, 2)
    std, sources, places = np.full(len(free), np.nan), np.full(len(free), "held", dtype=object), np.cumsum(free) - 1
    std[free] = statistics.std
    sources[free] = status(statistics.data_share, statistics.std / parameters.sigma_si[free], *kinds[free].T)
    half_widths = [HalfWidth(statistics, place) if use else np.nan for place, use in zip(places, free, strict=True)]
    numbers = np.stack([values, std, parameters.per_si], axis=1).tolist()
    return Estimates(
        {
            p.name: Estimate(p.name, p.unit, p.nominal_si, value, deviation, half, source, p.family, per_si)
            for p, (value, deviation, per_si), half, source in zip(
                parameters, numbers, half_widths, sources, strict=True
            )
        }
    )
