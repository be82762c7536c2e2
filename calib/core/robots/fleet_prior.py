"""The prior from other robots of a model: the key `fleet` of a robot description, which `calib fleet` writes.

Each parameter of a robot differs from the fleet's mean by a spread s_k, independently of the others. The mean itself is
uncertain. In units of the spreads, it is unsure by G z with z ~ N(0, I): a column of G is one combination of parameters
that the fleet leaves open, a row is `unsure` of one parameter. So one more robot of the model is

    p_k = nominal_k + offset_k + s_k u_k,        u ~ N(0, I + G G^T)

So the sum of two parameters can be well known (because poses saw it), although each of them alone is hardly known.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import DescriptionError, require_known
from calib.core.base.parameter import Parameter
from calib.core.base.sections import Quantity, Section
from calib.core.base.units import quantity


class FleetParameter(Section):
    """One parameter over the robots of a fleet.

    Attributes:
        offset: Mean of the robots minus nominal.
        spread: Standard deviation from robot to robot.
        unsure: A row of G of the module docstring.
    """

    offset: Quantity
    spread: Quantity
    unsure: tuple[Annotated[float, Field(allow_inf_nan=False)], ...] = ()


class FleetSection(Section):
    """Parameters of other robots of the model, as a prior.

    Attributes:
        robots: Number of robots from which it was learned.
        noise_freedom: Degrees of freedom with which results of the fleet confirmed the stated noise; 0 if they did not.
            With few readings, this noise is used.
        parameters: Prior of each parameter, by name.
        unlike: Parameters in which this robot is unlike the others: they have no prior of the fleet.
    """

    robots: Annotated[int, Field(ge=2)]
    noise_freedom: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0
    parameters: dict[str, FleetParameter] = Field(min_length=1)
    unlike: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _same_length(self) -> FleetSection:
        name, first = next(iter(self.parameters.items()))
        for other, parameter in self.parameters.items():
            if len(parameter.unsure) != len(first.unsure):
                raise ValueError(
                    f"'unsure' has {len(parameter.unsure)} numbers for '{other}' and {len(first.unsure)} for '{name}';"
                    " all parameters must have the same number: write the file again with `calib fleet`"
                )
        return self

    def knows(self, name: str) -> bool:
        """Whether the fleet gives a prior of a parameter."""
        return name in self.parameters and name not in self.unlike

    def check(self, parameters: Sequence[Parameter], where: str) -> None:
        """Raise `DescriptionError` for a parameter that a robot does not have, or that robots do not share."""
        known = {p.name: p for p in parameters}
        for name in (*self.parameters, *self.unlike):
            require_known(name, known, f"{where}: fleet: no parameter", DescriptionError)
            if known[name].placement or known[name].family:
                raise DescriptionError(
                    f"{where}: fleet: '{name}' is not a parameter that robots of a model share: places depend on where"
                    " each was measured, and sizes of curves are found from data; leave it out"
                )

    def expected(self, parameters: Iterable[Parameter], where: str) -> tuple[Parameter, ...]:
        """Return parameters with their priors from the fleet; those that the fleet does not know stay as they are.

        `DescriptionError` if a number has a unit of another dimension, or a spread is not positive.
        """
        return tuple(self._expected_parameter(p, where) if self.knows(p.name) else p for p in parameters)

    def _expected_parameter(self, parameter: Parameter, where: str) -> Parameter:
        entry = self.parameters[parameter.name]
        place, dimension = f"{where}: fleet: {parameter.name}", parameter.dimension
        offset = quantity(entry.offset, dimension, f"{place}, offset", DescriptionError)
        spread = quantity(entry.spread, dimension, f"{place}, spread", DescriptionError)
        if spread <= 0:
            raise DescriptionError(
                f"{where}: fleet: {parameter.name}: spread must be positive; hold a parameter that is always the same"
            )
        sigma = spread * float(np.sqrt(1.0 + np.sum(np.square(entry.unsure))))
        return replace(parameter, sigma_si=sigma, prior=True, mean_si=parameter.nominal_si + offset)

    def widen(self, factor: float, parameters: Iterable[Parameter]) -> FleetSection:
        """Return the fleet's prior with all uncertainties times a factor; dimensions are those of `parameters`."""
        dimension = {p.name: p.dimension for p in parameters}
        wide = {
            name: parameter.model_copy(update={"spread": factor * quantity(parameter.spread, dimension[name], name)})
            for name, parameter in self.parameters.items()
            if name in dimension
        }
        return self.model_copy(update={"parameters": wide})

    def correlations(self, names: Sequence[str]) -> FloatArray:
        """Return the correlation coefficients of some parameters of one more robot, (n, n)."""
        covariance = self.covariance(names)
        size = np.sqrt(np.diag(covariance))
        return np.asarray(covariance / size[:, None] / size)

    def covariance(self, names: Sequence[str]) -> FloatArray:
        """Return I + G G^T of some parameters, (n, n), in units of their spreads."""
        unsure = np.array([self.parameters[name].unsure for name in names]).reshape(len(names), -1)
        return np.asarray(np.eye(len(names)) + unsure @ unsure.T)
