"""Run the numerical tests with the sums of several processors: `make test-processors`.

OpenBLAS, below numpy and scipy, has kernels for each family of processors. They add in different orders, so results
differ in the last digit; a decision that hangs on that digit is wrong on some machine. OPENBLAS_CORETYPE chooses the
kernels of another processor. numpy's own sums depend on the processor as well: NPY_DISABLE_CPU_FEATURES makes it add as
one without AVX512, or without AVX2, would. What this processor cannot run is skipped, and so are its own sums, with
which `make test` runs everything. Tests on real data are among them where these lie beside the project.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
CORE_TYPES = {
    "Prescott": {"pni"},
    "Haswell": {"avx2", "fma"},
    "Zen": {"avx2", "fma"},
    "SkylakeX": {"avx512f", "avx512dq", "avx512bw", "avx512vl"},
}
"""Names of OpenBLAS, and what the processor must be able to do, in the words of /proc/cpuinfo."""
WITHOUT = {
    "AVX512": ("X86_V4", "AVX512"),
    "AVX2": ("X86_V4", "AVX512", "X86_V3", "AVX2", "FMA3"),
}
"""Beginnings of the names of what numpy is told to do without, in the words of several of its versions."""
NOT_NUMERICAL = (
    *("bad_input", "bad_kinds", "common_options", "files", "floors", "init_command", "many_calibrations", "next_steps"),
    *("own_files", "parameter_files", "plain_text", "rosbag", "searched_input", "sharing", "tables", "urdf_text"),
    *("wheel", "workers"),
)
"""Tests that hang on no sum: bad input, files and what is printed, processes, and everything whose name has `viz`."""
_DISPATCHED = (
    "from numpy._core._multiarray_umath import __cpu_dispatch__ as names, __cpu_features__ as able\n"
    "print(*(name for name in names if able.get(name)))"
)
_ARCHITECTURES = (
    "import numpy, scipy.linalg, threadpoolctl\n"
    "print(*sorted({str(library.get('architecture')) for library in threadpoolctl.threadpool_info()}))"
)


def main() -> int:
    """Run the tests once for each kind of kernels; return 1 if any failed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-n", dest="jobs", default="2", help="processes of pytest")
    jobs = parser.parse_args().jobs
    cpuinfo = Path("/proc/cpuinfo")
    able = set(cpuinfo.read_text(encoding="utf-8").split()) if cpuinfo.is_file() else set()
    files = [str(path) for path in sorted((ROOT / "tests").glob("test_*.py")) if _numerical(path.stem)]
    seen = {_output([sys.executable, "-c", _ARCHITECTURES], dict(os.environ)): "this processor, for `make test`"}
    failed = []
    for name, needed in CORE_TYPES.items():
        if missing := needed - able:
            print(f"{name}: skipped, this processor has no {', '.join(sorted(missing))}", flush=True)
            continue
        environment = os.environ | {"OPENBLAS_CORETYPE": name, "OPENBLAS_NUM_THREADS": "1"}
        kernels = _output([sys.executable, "-c", _ARCHITECTURES], environment)
        if kernels in seen:
            print(f"{name}: skipped, the same kernels as those of {seen[kernels]}", flush=True)
            continue
        seen[kernels] = name
        if not _passes(name, environment, files, jobs):
            failed.append(name)
    kernels = _output([sys.executable, "-c", _DISPATCHED], dict(os.environ)).split()
    left_out = set[str]()
    for name, beginnings in WITHOUT.items():
        off = {kernel for kernel in kernels if kernel.startswith(beginnings)}
        if off == left_out:
            print(f"numpy without {name}: skipped, the same sums as before", flush=True)
            continue
        left_out = off
        environment = os.environ | {"NPY_DISABLE_CPU_FEATURES": " ".join(sorted(off))}
        if not _passes(f"numpy without {name}", environment, files, jobs):
            failed.append(f"numpy without {name}")
    print(f"failed with the sums of {', '.join(failed)}" if failed else "passed with all that could be run")
    return int(bool(failed))


def _numerical(name: str) -> bool:
    """Whether a file of tests hangs on sums."""
    return "viz" not in name and name.removeprefix("test_") not in NOT_NUMERICAL


def _passes(name: str, environment: dict[str, str], files: list[str], jobs: str) -> bool:
    """Whether the tests pass there."""
    print(f"{name}:", flush=True)
    command = [sys.executable, "-m", "pytest", "-n", jobs, "-p", "no:cacheprovider", *files]
    return subprocess.run(command, env=environment, cwd=ROOT, check=False).returncode == 0


def _output(command: list[str], environment: dict[str, str]) -> str:
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout.strip()


if __name__ == "__main__":
    sys.exit(main())
