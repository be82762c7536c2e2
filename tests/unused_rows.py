"""How many positions of real robots that a fit has not used lie in its 95 % regions, and what each mechanism adds.

    python -m tests.unused_rows FOLDER [--only WORDS] [--page]

The splits are those of `tests/claims.py`, as far as one instrument reads positions. The covariance of a reading is that
of the predicted position plus the noise found. A region is an ellipsoid of three coordinates. --page writes the table
into docs/uncertainty.md.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.stats import chi2, norm

import calib
from calib.core.base.arrays import FloatArray
from calib.core.base.errors import CalibrationError
from calib.core.rows.prediction import ParameterUncertainty
from tests.claims import splits
from tests.project import EXAMPLES
from tests.public_data import markdown, of_folder, written

PAGE = EXAMPLES.parent / "uncertainty.md"
TERMS = {"origins": None, "`--terms auto`": "auto"}


def mechanisms(fit: calib.Calibration) -> Iterator[tuple[str, ParameterUncertainty]]:
    """Yield the uncertainty of a fit as stated, and without each mechanism that can be left out of it."""
    known = fit.uncertainty
    yield "as stated", known
    yield "without *regions left out*", replace(known, covariance=known.covariance / fit.interval_factor**2)
    yield "without *undecided terms*", replace(known, undecided=None)
    yield "without *unexplained joint errors*", replace(known, joint_error=0.0)


def held(fit: calib.Calibration, known: ParameterUncertainty, errors: FloatArray) -> tuple[float, float]:
    """Return the part of unused positions, and of their coordinates, in the 95 % regions of an uncertainty."""
    data = fit.validation.data
    predicted = known.predict(fit.robot, data.joints, data.conditions, fit.validation.passive, turns=False)
    covariance = predicted.covariance[:, 0] + fit.sigma**2 * np.eye(3)
    squares = np.einsum("ni,nij,nj->n", errors, np.linalg.inv(covariance), errors)
    wider = predicted.coverage_factor / norm.ppf(0.975)
    std = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    inside = np.abs(errors) <= predicted.coverage_factor * std
    return float(np.mean(squares <= wider**2 * chi2.ppf(0.95, 3))), float(np.mean(inside))


def main() -> None:
    """Run the command line."""
    options = of_folder(__doc__, PAGE).parse_args()
    parts: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for split in splits(options.folder):
        if options.only not in f"{split.robot} {split.how}" or len(split.nominal.mechanism.targets) > 1:
            continue
        for terms in TERMS:
            try:
                fit = calib.fit(split.nominal, split.used, validation=split.unused, terms=TERMS[terms])
            except CalibrationError as error:
                print(f"{split.robot}, {split.how}: refused: {error}", flush=True)
                continue
            if fit.validation.main_part.name == "position" and len(fit.noise) == 1:
                errors = fit.validation.errors("after", "position", single=True)
                for name, known in mechanisms(fit):
                    parts.setdefault((name, terms), []).append(held(fit, known, errors))
    rows = []
    for name in dict.fromkeys(name for name, _ in parts):
        means = [100 * np.mean(parts[name, terms], axis=0) for terms in TERMS]
        rows.append([name, *(f"{region:.1f}, {one:.1f}" for region, one in means)])
    table = markdown([f"{len(next(iter(parts.values())))} fits each", *TERMS], rows)
    print(table)
    if options.page:
        written(PAGE, "unused rows", table)


if __name__ == "__main__":
    main()
