"""Run the numerical tests with the sums of other processors: `make test-processors`.

OpenBLAS, below numpy and scipy, has kernels for each family of processors. They add in different orders, so results
differ in the last digit; a decision that hangs on that digit is wrong on some machine. OPENBLAS_CORETYPE chooses the
kernels of another processor. numpy's own sums depend on the processor as well: NPY_DISABLE_CPU_FEATURES makes it add as
one without AVX512, or without AVX2, would. The tests run twice: as on an old processor (without AVX2, in both), and as
on another new one. `make test` and `make test-thorough` run them with the sums of this one. Tests on real data are
among them where these lie beside the project.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from pathlib import Path

from tests.project import ROOT

OLD = "Prescott"
"""Kernels without AVX2, a name of OpenBLAS."""
NEW = {
    "Haswell": {"avx2", "fma"},
    "Zen": {"avx2", "fma"},
    "SkylakeX": {"avx512f", "avx512dq", "avx512bw", "avx512vl"},
}
"""Kernels of newer processors, and what a processor must be able to do, in the words of /proc/cpuinfo."""
AVX512 = ("X86_V4", "AVX512")
AVX2 = ("X86_V3", "AVX2", "FMA3")
"""Beginnings of the names of what numpy is told to do without, in the words of several of its versions."""
FOLDERS_LEFT_OUT = {"browser", "code_comparison", "docs", "interop", "viz"}
NOT_NUMERICAL = (
    *("bad_input", "bad_kinds", "common_options", "description", "files"),
    *("function_gradients", "guesses", "init_command", "many_calibrations", "next_steps", "other_words", "own_files"),
    *("foreign_files", "gcode_firmwares", "program_reading", "programs_run", "tolerance"),
    *("parameter_files", "plain_text", "remembered", "rosbag", "searched_input", "sharing", "tables", "urdf_text"),
    *("wheel", "workers"),
)
"""Tests that depend on no sum of these: bad input, files and what is printed, processes, programs of others, and code
that other packages compile."""
_DISPATCHED = (
    "from numpy._core._multiarray_umath import __cpu_dispatch__ as names, __cpu_features__ as able\n"
    "print(*(name for name in names if able.get(name)))"
)
_ARCHITECTURES = (
    "import numpy, scipy.linalg, threadpoolctl\n"
    "print(*sorted({str(library.get('architecture')) for library in threadpoolctl.threadpool_info()}))"
)


def main() -> int:
    """Run the tests once for each processor; return 1 if any failed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-n", dest="jobs", default="2", help="processes of pytest")
    jobs = parser.parse_args().jobs
    cpuinfo = Path("/proc/cpuinfo")
    able = set(cpuinfo.read_text(encoding="utf-8").split()) if cpuinfo.is_file() else set()
    files = [str(path) for path in sorted((ROOT / "tests").rglob("test_*.py")) if _numerical(path)]
    own = _kernels(None)
    others = [name for name, needed in NEW.items() if needed <= able and _kernels(name) != own]
    processors = [(OLD, (*AVX512, *AVX2)), *((name, AVX512) for name in others[:1])]
    if _kernels(OLD) == own:
        print(f"OpenBLAS has no other kernels here than those of {own}")
        processors = processors[1:]
    failed = [kernels for kernels, without in processors if not _passes(kernels, without, files, jobs)]
    print(f"failed with the sums of {', '.join(failed)}" if failed else "passed with all that could be run")
    return int(bool(failed))


def _numerical(path: Path) -> bool:
    """Whether a file of tests hangs on sums."""
    return path.parent.name not in FOLDERS_LEFT_OUT and path.stem.removeprefix("test_") not in NOT_NUMERICAL


def _passes(kernels: str, without: tuple[str, ...], files: list[str], jobs: str) -> bool:
    """Whether the tests pass with these kernels of OpenBLAS, and numpy without these abilities."""
    off = sorted(name for name in _output(_DISPATCHED, dict(os.environ)).split() if name.startswith(without))
    print(f"kernels of {kernels}, numpy without {', '.join(off) or 'nothing'}:", flush=True)
    sums = {"OPENBLAS_CORETYPE": kernels, "NPY_DISABLE_CPU_FEATURES": " ".join(off)}
    environment = os.environ | sums | {"CALIB_TESTS": "every-case"}
    command = [sys.executable, "-m", "pytest", "-n", jobs, "--dist", "loadfile", "-p", "no:cacheprovider", *files]
    return subprocess.run(command, env=environment, cwd=ROOT, check=False).returncode == 0


def _kernels(name: str | None) -> str:
    """What OpenBLAS says that it uses when it is told to use these; None: by itself."""
    return _output(_ARCHITECTURES, os.environ | ({} if name is None else {"OPENBLAS_CORETYPE": name}))


def _output(program: str, environment: dict[str, str]) -> str:
    command = [sys.executable, "-c", program]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout.strip()


if __name__ == "__main__":
    sys.exit(main())
