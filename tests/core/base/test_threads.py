"""One BLAS thread, also of libraries that are loaded late."""

import os
import subprocess
import sys
from functools import partial
from unittest import mock

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from calib.core.fitting.unexplained import unexplained_errors
from calib.core.judging.acceptance import verify
from tests.viz.viz_examples import five_bar_fit
from viz.pictures import pages

PROGRAM = """
import sys

from threadpoolctl import threadpool_info

from calib.core.base.threads import one_blas_thread


@one_blas_thread
def threads():
    import scipy.linalg

    return [library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"]


assert "scipy.linalg" not in sys.modules
print(*threads())
"""


def test_a_blas_that_is_loaded_inside_the_function_has_one_thread_as_well():
    """NumPy and SciPy bring one each; that of SciPy comes with its first use."""
    environment = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    environment["OPENBLAS_NUM_THREADS"] = "2"
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, env=environment, check=True)
    assert set(done.stdout.split()) == {"1"}


@pytest.mark.parametrize(
    ("compute", "within"),
    [
        (pages, "viz.scene.scene_of_fit"),
        (partial(unexplained_errors, sized=False), "calib.core.fitting.unexplained.likeliest_sizes"),
        (lambda fit: verify(fit, fit.identification.data), "calib.core.judging.acceptance.without_outliers"),
        (lambda fit: fit.save("never", pages=False), "calib.core.results.results._covariance_table"),
    ],
)
def test_pages_results_and_verdicts_on_new_readings_are_computed_with_one_thread(compute, within):
    """On two busy cores, two threads took a second of the time of a page of 300 poses."""
    threads = set()

    def looking(*arguments, **options):
        own = (library for library in threadpool_info() if library["prefix"] == "libscipy_openblas")  # NumPy, SciPy
        threads.update(library["num_threads"] for library in own)
        raise KeyboardInterrupt

    with threadpool_limits(2, user_api="blas"), mock.patch(within, looking), pytest.raises(KeyboardInterrupt):
        compute(five_bar_fit())
    assert threads == {1}
