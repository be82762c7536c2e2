"""A tolerance that a description or a file of measurements states takes part in the grade."""

import pytest

from calib.core.base.errors import DataError, DescriptionError
from calib.core.base.units import stated_tolerance
from calib.core.robots.description import read_description
from tests.project import EXAMPLES, copied


def test_the_smallest_tolerance_of_the_comments_counts():
    comments = ("written by a tracker", "Tolerance: 0.2 mm", "tolerance = 50 um", "columns: 0.1 mm")
    assert stated_tolerance(comments, "a.csv") == pytest.approx(5e-5)
    assert stated_tolerance(("no tolerance here: 0.1 mm",), "a.csv") is None


@pytest.mark.parametrize(
    ("comment", "says"),
    [
        ("tolerance: 0.1", "is not a positive length with a unit; write '# tolerance: 0.1 mm'"),
        ("tolerance: -1 mm", "is not a positive length with a unit"),
        ("tolerance: 1 deg", "unit 'deg' is for an angle"),
        ("tolerance: fine", "is not a finite number with a unit"),
        ("tolerence: 0.1 mm", "did you mean 'tolerance'"),
    ],
)
def test_a_tolerance_that_is_not_understood_is_an_error(comment, says):
    with pytest.raises(DataError, match=f"a.csv: comment '{comment}'.*{says}"):
        stated_tolerance((comment,), "a.csv")


def test_a_comment_of_a_description_states_the_tolerance_but_not_one_inside_an_entry(tmp_path):
    text = (EXAMPLES / "arm.yaml").read_text()
    (tmp_path / "robot.yaml").write_text(f"#tolerance: 0.06 mm\n{text}#   tolerance: 0.01 mm\n  # tolerance: 0.01 mm\n")
    assert read_description(tmp_path / "robot.yaml").tolerance == pytest.approx(6e-5)
    (tmp_path / "robot.yaml").write_text(f"# tolerance: 0.06\n{text}")
    with pytest.raises(
        DescriptionError, match=r"robot\.yaml: comment 'tolerance: 0\.06': is not a positive length with a unit"
    ):
        read_description(tmp_path / "robot.yaml")


@pytest.mark.quick(0)
def test_a_claim_above_the_tolerance_of_file_or_description_is_no_pass(run_calib, tmp_path):
    wide, measured = "# tolerance: 0.2 mm\n", (EXAMPLES / "arm_simulated.csv").read_text()
    for head, entry, comment, broken in (
        ("", "", "", ""),
        ("", "", wide, ""),
        ("", "", "# tolerance: 0.05 mm\n", "0.05 mm"),
        ("", "tolerance: 0.06 mm\n", wide, "0.06 mm"),
        ("# tolerance: 0.06 mm\n", "tolerance: 0.2 mm\n", wide, "0.06 mm"),
    ):
        robot = copied(tmp_path, EXAMPLES / "arm.yaml", more=entry)
        robot.write_text(head + robot.read_text())
        (tmp_path / "data.csv").write_text(comment + measured)
        run = run_calib("fit", robot, "data.csv", "--no-pages", "--out", "out", cwd=tmp_path)
        assert run.code == 0, run.err
        assert f"Verdict: {'CHECK' if broken else 'PASS'}" in run.out
        words = f"CHECK: the claim is 0.0853 mm (95 % of the time), above the tolerance of {broken}"
        assert (words in " ".join(run.out.split())) == bool(broken)
