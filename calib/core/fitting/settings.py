"""The options of a fit, checked when they are set."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from calib.core.base.errors import DataError, InputError
from calib.core.numerics.losses import Loss, find_loss


@dataclass(frozen=True)
class RequestedOptions:
    """Options of a fit that a repeated fit needs and that neither its settings nor its robot hold.

    Attributes:
        prior: Expected errors of parameters, by name.
        validation: The part of the poses that was held out, or the file of other poses; empty for neither.
        folds: As in `Settings`.
    """

    fix: tuple[str, ...] = ()
    free: tuple[str, ...] = ()
    prior: Mapping[str, str] = field(default_factory=dict)
    validation: str = ""
    folds: int | Literal["setups"] = 0

    def options(self) -> dict[str, str]:
        """Return these options of `calib fit` with their values."""
        priors = (f"{name}={''.join(how_far.split())}" for name, how_far in self.prior.items())
        options = {
            "--validate": self.validation,
            "--folds": str(self.folds) if self.folds else "",
            "--fix": ",".join(self.fix),
            "--free": ",".join(self.free),
            "--prior": ",".join(priors),
        }
        return {name: value for name, value in options.items() if value}


@dataclass(frozen=True)
class Settings:
    """Settings of a fit: arguments of `calib.fit` with the same names and meanings.

    Here `sigma` is one number for all readings [m], and `terms` are text.

    Raises:
        DataError: Sigma is not a positive number.
        InputError: Unknown loss, or a number of starts or a seed that makes no sense.
    """

    sigma: float | None = None
    loss: Loss = "none"
    exclude_outliers: bool = False
    starts: int = 1
    folds: int | Literal["setups"] = 0
    seed: int = 0
    terms: str | None = None

    def __post_init__(self) -> None:
        if self.sigma is not None and not (np.isfinite(self.sigma) and self.sigma > 0):
            raise DataError(f"sigma {self.sigma:g} m: must be a positive number")
        find_loss(self.loss)
        if self.starts < 1:
            raise InputError(f"starts {self.starts}: must be 1 or more")
        if self.seed < 0:
            raise InputError(f"seed {self.seed}: must be zero or more")
