"""Installation qualification: installed files, compared with their publishers' checksums.

Every wheel lists the SHA-256 of each of its files (RECORD, PEP 376 and 427). A file that differs from its entry was
changed after installation. An editable installation of this program has no such list, which is noted; then only
operation qualification can find a changed number.
"""

from __future__ import annotations

import base64
import hashlib
import os
import platform
import sys
from collections.abc import Iterator
from functools import partial
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

import threadpoolctl
from packaging.requirements import Requirement
from packaging.version import Version

from calib.core.base.version import DISTRIBUTION, VERSION
from calib.core.base.words import listing
from calib.quality.protocol import Check, Outcome, Phase

_PHASE = Phase.INSTALLATION
_check = partial(Check.from_values, _PHASE)
_SEALED = "every file has the SHA-256 that its wheel lists (RECORD)"
_OLDEST_BLAS = {"openblas": Version("0.3.21")}
"""OpenBLAS before 0.3.21 has known errors in kernels of current processors (its changelog)."""


def machine_facts() -> dict[str, str]:
    """Return the facts that identify the program and the machine, by name."""
    libraries = sorted({_library(entry) for entry in threadpoolctl.threadpool_info() if entry["user_api"] == "blas"})
    return {
        "program": f"{DISTRIBUTION} {VERSION}",
        "Python": f"{platform.python_implementation()} {platform.python_version()}",
        "system": platform.platform(),
        "processor": f"{platform.machine()} {platform.processor()}".strip(),
        "linear algebra": "; ".join(libraries),
        "byte order": sys.byteorder,
    }


def installation_checks() -> Iterator[Check]:
    """Yield the checks of versions, of files and of the linear algebra library."""
    own = distribution(DISTRIBUTION)
    for requirement in _requirements(own):
        yield from _dependency(requirement)
    yield from _check_files(own)
    yield from _linear_algebra()


def _requirements(own: Distribution) -> list[Requirement]:
    """Requirements of the program without its extras."""
    all_of_them = [Requirement(text) for text in own.requires or ()]
    return [each for each in all_of_them if each.marker is None or each.marker.evaluate({"extra": ""})]


def _dependency(requirement: Requirement) -> Iterator[Check]:
    subject, expected = f"version of {requirement.name}", f"{requirement.specifier or 'any'} (pyproject.toml)"
    try:
        found = distribution(requirement.name)
    except PackageNotFoundError:
        yield _check(subject, expected, "not installed", False)
        return
    yield _check(subject, expected, found.version, requirement.specifier.contains(found.version, True))
    yield from _check_files(found)


def _check_files(of: Distribution) -> Iterator[Check]:
    """Compare the files of a distribution with its list; note a missing list."""
    subject = f"files of {of.name} {of.version}"
    listed = {file: file.hash.value for file in of.files or () if file.hash is not None and file.hash.mode == "sha256"}
    if not any(file.suffix in (".py", ".so", ".pyd", ".dylib") for file in listed):
        yield Check(_PHASE, subject, _SEALED, "installed for development: no list of files to compare", Outcome.NOTED)
        return
    changed = [str(file) for file, digest in listed.items() if digest != _digest(Path(str(of.locate_file(file))))]
    found = f"{len(changed)} changed or missing: {listing(changed)}" if changed else f"{len(listed)} files as listed"
    yield _check(subject, _SEALED, found, not changed)


def _digest(path: Path) -> str:
    """SHA-256 of a file as RECORD writes it; empty if the file is missing."""
    try:
        with path.open("rb", buffering=0) as stream:
            digest = hashlib.file_digest(stream, "sha256").digest()
    except OSError:
        return ""
    return base64.urlsafe_b64encode(digest).rstrip(b"=").decode()


def _linear_algebra() -> Iterator[Check]:
    own = [os.path.realpath(str(distribution(name).locate_file(name))) for name in ("numpy", "scipy")]  # or .libs
    for entry in threadpoolctl.threadpool_info():
        if "filepath" in entry and not os.path.realpath(entry["filepath"]).startswith(tuple(own)):
            continue  # a library of another package, such as OpenCV, which computes nothing here
        oldest = _OLDEST_BLAS.get(str(entry["internal_api"]))
        if oldest is not None:
            version = str(entry["version"])
            passed = version != "None" and Version(version) >= oldest
            yield _check("linear algebra library", f"OpenBLAS {oldest} or newer", _library(entry), passed)


def _library(entry: dict[str, object]) -> str:
    return f"{entry['internal_api']} {entry['version']} ({entry.get('architecture', 'unknown kernels')})"
