"""`calib qualify`: green on an installation that is sound, red for each of a dozen planted faults."""

import base64
import hashlib
import json
from dataclasses import replace
from importlib.metadata import FileHash, PackagePath
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from packaging.requirements import Requirement

from calib.core.judging import verdict
from calib.core.numerics import least_squares
from calib.core.numerics.statistics import Statistics
from calib.core.robots import kinematics
from calib.core.robots.robot import Robot
from calib.quality import installation, operation, performance
from calib.quality.command import protocol_document
from calib.quality.documents import Document, DocumentRows
from calib.quality.protocol import Check, Outcome, Phase, Protocol, run_checks
from calib.quality.references import sample_robots


def failures(*pieces):
    """Subjects of failed checks of pieces of work, by the function that does each."""
    checks = run_checks([(Phase.OPERATION, piece.__name__, piece) for piece in pieces])
    return [check.subject for check in checks if check.outcome is Outcome.FAIL]


def regressions():
    for problem in operation.PROBLEMS:
        yield from operation._regression(problem)


@pytest.mark.quick(0)
@pytest.mark.amount(1, 8)
def test_a_sound_installation_has_no_failed_check(tmp_path, run_calib, monkeypatch, amount):
    """With some of the eight robots, fits and runs of the program, each of which is a process."""
    monkeypatch.setattr(operation, "sample_robots", lambda: islice(sample_robots(), amount))
    monkeypatch.setattr(operation, "_FITS", 10 if amount == 1 else 40)
    monkeypatch.setattr(operation, "_INPUTS", operation._INPUTS[-2 * amount :])
    run = run_calib("qualify", "--out", tmp_path / "protocol")
    assert run.code == 0, run.err
    protocol = json.loads((tmp_path / "protocol" / "protocol.json").read_text())
    assert protocol["outcome"] == "PASS"
    assert {check["phase"] for check in protocol["checks"]} == {phase.value for phase in Phase}
    assert {check["subject"] for check in protocol["checks"]} >= {"MedRUE, nominal", "coverage of intervals"}
    page = (tmp_path / "protocol" / "protocol.html").read_text()
    assert "Reviewed by" in page
    assert "http" not in page


def changed_result(monkeypatch, home, name, change):
    """Let a function answer something else."""
    original = getattr(home, name)
    monkeypatch.setattr(home, name, lambda *given, **named: change(original(*given, **named)))


def test_a_solver_that_ends_too_early_is_found(monkeypatch):
    monkeypatch.setattr(least_squares, "_SMALL_STEP", 1e-3)
    assert any("regression" in subject for subject in failures(regressions))


def test_noise_that_is_found_too_small_is_found(monkeypatch):
    changed_result(monkeypatch, operation, "statistics", lambda found: found.widen(0.999))
    assert len(failures(regressions)) == 8


@pytest.mark.quick(0)
@pytest.mark.amount(10, 40)
@pytest.mark.parametrize("factor", [0.8, 1.3])
def test_intervals_of_another_width_are_found(monkeypatch, factor, amount):
    monkeypatch.setattr(operation, "_FITS", amount)
    right = Statistics.coverage_factor.fget
    monkeypatch.setattr(Statistics, "coverage_factor", property(lambda self: factor * right(self)))
    assert failures(operation._coverage) == ["coverage of intervals"]


def test_positions_that_are_a_hundredth_of_a_micrometre_off_are_found(monkeypatch):
    def shifted(poses):
        poses = np.array(poses)
        poses[:, 0, 3] += 1e-8 * poses[:, 0, 0]
        return poses

    changed_result(monkeypatch, kinematics, "relative_pose", shifted)
    assert failures(robot_of("six-axis arm")) == ["positions of the six-axis arm"]


def robot_of(name):
    """The checks of one of the eight robots."""

    def checks():
        yield from operation._robot(name, dict(sample_robots())[name], 1)

    return checks


def test_loops_that_stay_a_tenth_of_a_micrometre_open_are_found(monkeypatch):
    changed_result(monkeypatch, Robot, "assemble", lambda found: replace(found, passive=found.passive + 1e-7))
    assert "positions of the planar five-bar" in failures(robot_of("planar five-bar"))


def test_derivatives_that_are_a_hundred_thousandth_too_large_are_found(monkeypatch):
    changed_result(monkeypatch, Robot, "jacobian", lambda found: 1.00001 * found)
    assert failures(robot_of("SCARA")) == ["Jacobian of the SCARA"]


@pytest.mark.quick(0)
def test_a_verdict_that_finds_nothing_is_found(monkeypatch):
    monkeypatch.setattr(verdict, "_RULES", ())
    monkeypatch.setattr(verdict.rules_model, "claim_broken", lambda *_, **__: ())
    assert failures(performance._check_mistakes)


def test_a_claim_that_is_too_small_is_found(monkeypatch):
    def halved(found):
        told = replace(found.claim.at_measured_poses, rms=0.5 * found.claim.at_measured_poses.rms)
        return replace(found, claim=replace(found.claim, at_measured_poses=told))

    changed_result(monkeypatch, performance, "judge", halved)
    assert failures(performance._check_simulated) == ["claim about a simulated robot"]


def test_numbers_that_differ_in_the_last_bit_are_found(monkeypatch):
    factors = iter((1.0, 1 + 2e-16))

    def nudged(fit):
        fit.rows.residuals[0] *= next(factors)
        return fit

    changed_result(monkeypatch, operation, "calibrate", nudged)
    assert failures(operation._check_repeats) == ["same numbers twice"]


@pytest.mark.quick(0)
def test_another_exit_code_is_found(monkeypatch):
    codes = (("no such robot", ("fit", "missing.urdf", "missing.csv"), 1),)
    monkeypatch.setattr(operation, "_INPUTS", codes)
    assert failures(operation._exit_codes) == ["command line, no such robot"]


class Wheel:
    """What is installed of a wheel with one module."""

    name, version, requires = "wheel", "1.0", ("numpy>=999", "no-such-package>=1", "extra-only; extra == 'docs'")

    def __init__(self, folder, listed):
        self._folder = folder
        digest = base64.urlsafe_b64encode(hashlib.sha256(listed).digest()).rstrip(b"=").decode()
        file = PackagePath("module.py")
        file.hash = FileHash(f"sha256={digest}")
        self.files = [file]

    def locate_file(self, file):
        return self._folder / file


@pytest.mark.parametrize(("content", "outcome"), [(b"SIZE = 1\n", "PASS"), (b"SIZE = 2\n", "FAIL"), (None, "FAIL")])
def test_a_file_that_is_not_as_its_wheel_lists_it_is_found(tmp_path, content, outcome):
    if content is not None:
        (tmp_path / "module.py").write_bytes(content)
    (check,) = installation._check_files(Wheel(tmp_path, b"SIZE = 1\n"))
    assert check.outcome.value == outcome


def test_packages_that_are_missing_or_too_old_are_found(tmp_path):
    required = installation._requirements(Wheel(tmp_path, b""))
    assert [each.name for each in required] == ["numpy", "no-such-package"]
    assert next(installation._dependency(required[0])).outcome is Outcome.FAIL
    assert next(installation._dependency(Requirement("no-such-package>=1"))).found == "not installed"


def test_an_old_linear_algebra_library_is_found_and_one_of_another_package_computes_nothing_here(monkeypatch):
    packages = Path(np.__file__).parent.parent
    entry = {"user_api": "blas", "internal_api": "openblas", "version": "0.3.7", "architecture": "Haswell"}
    of_opencv, of_numpy = (
        entry | {"filepath": str(packages / folder / "libopenblas.so")}
        for folder in ("opencv_python_headless.libs", "numpy.libs")
    )
    for loaded in ([entry], [of_opencv, of_numpy]):
        monkeypatch.setattr(installation.threadpoolctl, "threadpool_info", lambda loaded=loaded: loaded)
        (check,) = installation._linear_algebra()
        assert check.outcome is Outcome.FAIL


def test_work_that_ends_in_an_error_is_a_failed_check():
    def broken():
        yield Check.from_values(Phase.OPERATION, "one", "", "", True)
        raise ValueError("no such matrix")

    checks = run_checks([(Phase.OPERATION, "two", broken)])
    assert [check.outcome for check in checks] == [Outcome.PASS, Outcome.FAIL]
    assert checks[1].found == "ValueError: no such matrix"


def test_the_protocol_says_how_many_failed():
    checks = tuple(Check.from_values(Phase.OPERATION, "x", "<1", "2 & 3", passed) for passed in (True, False))
    document = protocol_document(Protocol(checks, {"Python": "3"}, "2026-01-01", 1.0))
    assert document.answer == "FAIL: 1 of 2 checks failed"
    assert "&lt;1" in document.html()
    assert "2 &amp; 3" in document.html()


def test_a_document_is_a_pdf():
    pytest.importorskip("fpdf")
    rows = DocumentRows("Table", ("a", "b"), (("Größe ±", "0" * 100),))
    assert Document("Title", "PASS", (rows,), ("Performed by",)).pdf().startswith(b"%PDF-")
