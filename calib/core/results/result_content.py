"""The content of a result in mm and degrees: dictionaries for `result.json`."""

from __future__ import annotations

from dataclasses import asdict

from calib.core.base.threads import one_blas_thread
from calib.core.base.version import PROGRAM
from calib.core.base.words import as_data
from calib.core.fitting.fitted import Fit
from calib.core.judging import findings
from calib.core.judging.next_step import next_step
from calib.core.judging.repeatability import repeat_table, repeatability
from calib.core.judging.verdict import judge
from calib.core.results.saved_fit import VERSION
from calib.core.results.sections.budget import budget_table
from calib.core.results.sections.details import contents_table, folds_table, starts_table
from calib.core.results.sections.determination import correlated_pairs, position_uncertainty_table, rank_content
from calib.core.results.sections.files_held import file_entries
from calib.core.results.sections.noise import instrument_blocks
from calib.core.results.sections.outliers import excluded_rows, outlier_rows, with_excluded
from calib.core.results.sections.parameters import parameter_rows
from calib.core.results.sections.terms import terms_table

NOMINAL_YAML, NOMINAL_URDF = "nominal.yaml", "nominal.urdf"
"""Files of the nominal robot in a result folder."""


@one_blas_thread
def to_dict(fit: Fit, *, forced: bool = False) -> dict[str, object]:
    """Return the content of `result.json`; `forced` says whether a failed result is exported nevertheless."""
    data = fit.identification.data
    return as_data(
        {
            "version": VERSION,
            "program": PROGRAM,
            "robot": fit.nominal.path,
            "data": data.path,
            "comments": comments(fit),
            "verdict": judge(fit).to_dict(forced=forced),
            "next": str(next_step(fit)),
            "converged": fit.converged,
            "message": fit.message,
            "seconds": fit.seconds,
            "seed": fit.seed,
            "n_poses": data.n_poses,
            "n_rows": len(data),
            "n_readings": data.n_readings,
            **rank_content(fit),
            "sigma": fit.sigma,
            "sigma_stated": fit.sigma_stated,
            "degrees_of_freedom": fit.statistics.freedom,
            "effective_parameters": fit.statistics.effective_parameters,
            "chi_square": None if fit.chi_square is None else asdict(fit.chi_square),
            "interval_degrees_of_freedom": fit.statistics.interval_freedom,
            "widened": fit.interval_factor,
            "joint_error": fit.joint_error,
            "shared": None if fit.statistics.shared_scatter is None else fit.statistics.shared_scatter.ratio,
            "repeatability": repeatability(fit.identification)[0],
            "repeats": repeat_table(fit.identification),
            "repeats_validation": None if fit.validation is None else repeat_table(fit.validation),
            "observability": fit.observability,
            "parameters": parameter_rows(fit),
            "correlations": correlated_pairs(fit),
            "errors": fit.errors,
            "instruments": instrument_blocks(fit),
            "error_budget": budget_table(fit),
            "position_uncertainty": position_uncertainty_table(fit),
            "contains": contents_table(fit),
            "loss": fit.loss,
            "outliers": outlier_rows(fit),
            "excluded": excluded_rows(fit),
            "with_excluded": with_excluded(fit),
            "patterns": [asdict(pattern) for pattern in findings.patterns(fit)],
            "starts": starts_table(fit),
            "cross_validation": folds_table(fit),
            "joint_terms": terms_table(fit),
            "files": file_entries(fit),
        }
    )


def comments(fit: Fit) -> list[str]:
    """Return the comment lines of the measurement files, each line once."""
    files = [fit.identification.data] + ([] if fit.validation is None else [fit.validation.data])
    return list(dict.fromkeys(line for data in files for line in data.comments))
