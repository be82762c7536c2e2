"""One BLAS thread, also of libraries that are loaded late."""

import os
import subprocess
import sys

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
