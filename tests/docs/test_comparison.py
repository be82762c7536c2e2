"""The numbers of this project on the comparison page; skipped where the real measurements are absent."""

import re
import shutil

import pytest
from snippets import DOCS, ROOT

import calib


@pytest.fixture(scope="module")
def motoman(shared_data, tmp_path_factory):
    folder = tmp_path_factory.mktemp("motoman")
    for path in (*(shared_data / "motoman_right").glob("*.*"), DOCS / "examples" / "motoman_right.yaml"):
        shutil.copy(path, folder)
    robot = calib.load(folder / "motoman_right.yaml")
    train, test = (calib.read_measurements(folder / name, robot) for name in ("train.csv", "test.csv"))
    return calib.fit(robot, train, validation=test)


@pytest.mark.parametrize(
    ("row", "state"), [("base and target placed, robot nominal", "before"), ("this project", "after")]
)
def test_the_page_has_what_a_fit_gives(motoman, row, state):
    found = motoman.validation.table()[state]
    page = (DOCS / "comparison.md").read_text()
    mean, rms, largest = re.search(rf"^\| {row} \|[^|]*\| ([\d.]+) \| ([\d.]+) \| ([\d.]+) \|", page, re.M).groups()
    assert float(mean) == pytest.approx(found["mean"], abs=0.0011)  # printed to 0.001 mm
    assert float(rms) == pytest.approx(found["rms"], abs=0.0011)
    assert float(largest) == pytest.approx(found["max"], abs=0.0011)


def test_the_page_has_the_reasons_of_the_verdict(motoman):
    reasons = motoman.verdict.reasons
    assert {reason.code for reason in reasons} == {"joint_never_moved", "joint_moved_little", "systematic"}
    page = " ".join((DOCS / "comparison.md").read_text().split())
    assert f"The verdict is {motoman.verdict.grade}, with remarks. Joint `E` never moved" in page
    assert any("joint E never moved" in reason.text for reason in reasons)
    little = [reason.text for reason in reasons if reason.code == "joint_moved_little"]
    assert [text.split()[1] for text in little] == ["S", "R", "B"]
    assert all(float(text.split()[4]) < 30 for text in little)
    assert any("joint U that repeats 80 cycles" in reason.text for reason in reasons if reason.code == "systematic")


def test_the_tests_that_the_page_names_exist():
    named = set(re.findall(r"`((?:\w+/)*test_\w+\.py)`", (DOCS / "comparison.md").read_text().replace("`tests/", "`")))
    assert len(named) > 5
    for name in named:
        assert (ROOT / "tests" / name).is_file(), name
