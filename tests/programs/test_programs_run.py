"""Programs that are generated, run before and after: moves differ by the correction, and by nothing else.

The correction is not that of a robot: every pose is moved by one small transform in the base, every joint by a small
angle. So what a move should become follows from the move itself, whatever the reader made of the program.

    python -m tests.programs.test_programs_run 10000 KRL    as the thorough tests do, of one language
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from calib.core.base.errors import DataError
from calib.programs.languages.languages import read_program
from tests.programs import programs_made as made
from tests.programs import programs_run as run
from tests.programs.controller_programs import frames_table

SHIFT = pin.SE3(pin.exp3(np.array([2e-3, -1e-3, 3e-3])), np.array([1e-3, 2e-3, -1.5e-3]))
TURN = 1e-3
ROUNDED = 6e-5  # three decimals of FANUC: half a micrometre, and 9e-6 rad over less than 2 m, of three angles
ALONG = 0.06  # what is computed from corrected numbers moves by as much as they do, or by a few times that [m]


def urscript(seed):
    text = made.URScriptMaker(seed).make()
    return {".script": text}, "", lambda texts: run.URScript(texts[0], seed).run()


def rapid(seed):
    return {".mod": made.RapidMaker(seed).make()}, "", lambda texts: run.Rapid(texts[0], seed).run()


def krl(seed):
    src, dat = made.KrlMaker(seed).make()
    return {".src": src, ".dat": dat}, "", lambda texts: run.Krl(*texts, seed).run()


def fanuc(seed):
    rng = np.random.default_rng(seed)
    frames = {
        name: run.pose(rng.uniform(-0.1, 0.1, 3), Rotation.from_euler("xyz", rng.uniform(-1, 1, 3)))
        for name in ("UFRAME[1]", "UFRAME[3]", "UTOOL[2]")
    }
    return (
        {".ls": made.FanucMaker(seed).make()},
        frames_table(frames),
        lambda texts: run.Fanuc(texts[0], dict(frames), seed).run(),
    )


LANGUAGES = {"URScript": urscript, "RAPID": rapid, "KRL": krl, "FANUC": fanuc}


def compensated(folder, files, table):
    """The texts of a program with every target moved, and the lines of what is not compensated; None if refused."""
    for suffix, text in files.items():
        (folder / f"part{suffix}").write_bytes(text.encode())
    (folder / "frames.csv").write_text(table)
    try:
        program = read_program(folder / f"part{next(iter(files))}", [folder / "frames.csv"] if table else [])
    except DataError as error:
        if "has no targets that can be compensated" in str(error):
            return None
        raise
    values = [
        tuple(value + TURN for value in target.values)
        if target.rotation is None
        else target.numbers_of(SHIFT * target.flange)
        for target in program.targets
    ]
    lines = {left.line for left in program.left_out if left.path == program.sources[0].path}
    return [content.decode() for content in program.rewritten(values)], lines


def misses(before, after):
    """How far a move is from the corrected one, and from where it was [m or rad]."""
    if before.to.shape == (6,):
        moved = float(np.abs(after.to - before.to).max())
        return abs(moved - TURN), moved
    should = SHIFT.homogeneous @ before.to
    points = np.array([[0, 0, 0, 1], [0.1, 0, 0, 1], [0, 0.1, 0, 1]]).T
    return tuple(float(np.abs((after.to - T) @ points).max()) for T in (should, before.to))


def judge(folder, language, seed):
    """Run a program before and after; return how many of its moves are corrected and how many are not."""
    files, table, execute = LANGUAGES[language](seed)
    result = compensated(folder, files, table)
    if result is None:
        return 0, 0
    texts, left = result
    before, after = execute(list(files.values())), execute(texts)
    assert [move.line for move in before] == [move.line for move in after], "it decides otherwise"
    for old, new in zip(before, after, strict=True):
        wrong, moved = misses(old, new)
        assert wrong < ROUNDED or (old.line in left and moved < ALONG), (old.line, wrong, moved)
    corrected = sum(misses(old, new)[0] < ROUNDED for old, new in zip(before, after, strict=True))
    return corrected, len(before) - corrected


@pytest.mark.quick(1)
@pytest.mark.amount(100, 10_000)
@pytest.mark.parametrize("language", LANGUAGES)
def test_moves_of_a_corrected_program_differ_by_the_correction_and_by_nothing_else(language, amount, tmp_path):
    counts = np.array([judge(tmp_path, language, seed) for seed in range(amount)])
    corrected, left = counts.sum(axis=0)
    assert np.mean(counts[:, 0] > 0) > 0.5  # programs with targets that are constant are compensated
    assert corrected > 0.3 * (corrected + left)


def main():
    """Judge many programs of each language; print how many, and every one that goes elsewhere."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("amount", type=int, help="how many of each language")
    parser.add_argument("languages", nargs="*", metavar="LANGUAGE", help="all if none is given")
    given = parser.parse_args()
    amount = given.amount
    for language in given.languages or LANGUAGES:
        counts, wrong = np.zeros((amount, 2), dtype=int), 0
        with tempfile.TemporaryDirectory() as folder:
            for seed in range(amount):
                try:
                    counts[seed] = judge(Path(folder), language, seed)
                except (AssertionError, DataError) as error:
                    wrong += 1
                    print(f"{language}, seed {seed}: {error}")
        corrected, left = counts.sum(axis=0)
        print(
            f"{language}: {amount} programs, {np.sum(counts[:, 0] > 0)} compensated; {corrected} moves corrected,"
            f" {left} left as they are; {wrong} programs wrong"
        )


if __name__ == "__main__":
    main()
