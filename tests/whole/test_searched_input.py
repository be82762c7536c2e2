"""Inputs that a search makes up: whatever a file holds, a run ends soon with 0, 2 or 3, and says nothing wrong.

Soon is below 20 s, and with no more than 2 GB of memory beside what the program itself takes.

Hypothesis edits the files of a good run (cells, numbers, words, lines, columns, bytes) and the options, and where a run
breaks a promise it shrinks the edits to the fewest. The suite makes the same few cases every time; a search is

    CALIB_TESTS=every-case CALIB_SEARCH=1000 python -m pytest tests/whole/test_searched_input.py --hypothesis-seed=1
"""

import csv
import json
import math
import os
import re
import resource
import shutil
import signal
import warnings
from contextlib import contextmanager

import hypothesis
import psutil
import pytest
from hypothesis import strategies as st

from tests.small_robots import PARALLELOGRAM_YAML, write_arm, write_parallelogram

SEARCHED = int(os.environ.get("CALIB_SEARCH", "0"))
SECONDS = 20  # that one run may take
MEMORY = 2 * 10**9  # bytes that one run may ask for
ATOMS = [
    "", " ", "0", "-0", "1", "-1", "2", "7", "1e-300", "1e-12", "1e9", "-1e9", "1e300", "1e400", "9" * 40, "0x10",
    "1_000", "nan", "NaN", "-inf", "inf", "1,5", "1.234,5", "1;2", "true", "null", "~", "None", "a", "mm", "1 mm",
    "3 deg", "tip", "turn", "hand", "upper", "x", "unknown", "all", "[]", "{}", "[1, 2, 3]", "{a: 1}", "1 0 0", "0 0 0",
    "nan nan nan", "1e200 0 0", "'", '"', "<", "&amp;", "&lt;script&gt;", "<!--", "]]>", "=1+1", "@x", "#", "# x", ",",
    "\t", "\n", "\r", "\x00", "\x1b[31m", "\x7f", "\ufeff", "\u202e", "\u0661", "é", "\U0001f916", "!!python/name:os",
    "&a [*a]", "*a", "<<", "../", "/dev/null", "..", "package://x/y.stl", "${x}", "%s", "\\", "prismatic", "fixed",
    "revolute", "continuous", "floating", "planar", "3d", "6d", "[" * 3000, "{" * 3000, "x" * 3000, "(" * 100,
]  # fmt: skip
OPTIONS = [
    "--sigma-mm nan", "--sigma-mm 1e-300", "--sigma-mm 1e300", "--sigma-mm 1e5", "--sigma-mm 0", "--seed 0",
    "--seed -1", "--seed 99999999999999999999", "--validate 0.3", "--validate 1e-9", "--validate nan",
    "--validate data.csv", "--folds 2", "--folds 99", "--folds -3", "--starts 2", "--starts 0",
    "--loss huber", "--loss tukey", "--terms none",
    "--terms gain", "--terms ,", "--exclude-outliers", "--force", "--parameters p.csv", "--parameters data.csv",
    "--result out", "--result .", "--json -", "--json j.json", "--json out", "--quiet", "--skip-unreachable",
    "--poses 3", "--poses 0", "--poses -1", "--count 3", "--count 0", "--count 5..2", "--count 99", "--index task",
    "--task data.csv", "--measured data.csv", "--exclude 1", "--min-distance-mm 1e9", "--min-distance-mm nan",
    "--start random", "--format urdf", "--format dh", "--format mdh", "--format mjcf", "--format drake",
    "--format toolbox", "--format xacro", "--format joint-offsets", "--format ur-kinematics", "--format joint-tables",
    "--keep axis", "--grid 2,2,2", "--grid 0,0,0", "--grid 9,,", "--same-setup", "--plan", "--change turn.x=1mm",
    "--change turn.x=nan", "--change x", "--provenance", "--free-slide", "--meshes ''", "--target tool", "--target x",
    "--instruments all", "--instruments each", "--out", "--out data.csv/x", "extra", "-", "''",
]  # fmt: skip
ROBOTS = {
    "urdf": ["predict arm.urdf joints.csv --out o.csv", "init arm.urdf --out o.yaml", "check arm.urdf --poses 8"],
    "description": ["predict arm.yaml joints.csv --out o.csv", "export arm.yaml --format mjcf --out o.xml"],
}
COMMANDS = {
    "arm.urdf": [*ROBOTS["urdf"], *ROBOTS["description"], "export arm.yaml --format urdf --out o.urdf",
                 "fit arm.yaml data.csv --no-pages --out o", "solve arm.yaml targets.csv --out o.csv"],
    "arm.yaml": [*ROBOTS["description"], "fit arm.yaml data.csv --no-pages --out o", "check arm.yaml data.csv",
                 "simulate arm.yaml joints.csv --sigma-mm 1 --seed 1 --out o.csv"],
    "data.csv": ["fit arm.yaml data.csv --no-pages --out o", "check arm.yaml data.csv --json j.json",
                 "verify out data.csv --json j.json", "predict arm.yaml data.csv --out o.csv",
                 "fit arm.yaml data.csv --no-pages --validate data.csv --out o"],
    "joints.csv": ["predict arm.yaml joints.csv --out o.csv --json j.json", "compensate out joints.csv --out o.csv",
                   "simulate arm.yaml joints.csv --sigma-mm 1 --seed 1 --out o.csv",
                   "select arm.yaml joints.csv --count 3 --out o.csv", "verify out joints.csv --plan --json j.json"],
    "targets.csv": ["solve arm.yaml targets.csv --out o.csv", "compensate out targets.csv --out o.csv",
                    "solve arm.yaml targets.csv --skip-unreachable --out o.csv --json j.json"],
    "p.csv": ["predict arm.yaml joints.csv --parameters p.csv --out o.csv",
              "export arm.yaml --parameters p.csv --format dh --out o.dh"],
    "out/result.json": ["predict out joints.csv --out o.csv", "export out --format urdf --out o.urdf",
                        "verify out data.csv", "compensate out joints.csv --out o.csv"],
    "out/parameters.csv": ["predict out joints.csv --out o.csv",
                           "export arm.yaml --result out --format urdf --out o.urdf"],
    "dh.csv": ["init --dh dh.csv --convention standard --out o.yaml",
               "init --dh dh.csv --convention modified --out o.yaml"],
    "parallelogram.yaml": ["predict parallelogram.yaml crank.csv --out o.csv",
                           "fit parallelogram.yaml crank.csv --no-pages --out o", "check parallelogram.yaml --poses 5"],
    "parallelogram.urdf": ["predict parallelogram.yaml crank.csv --out o.csv", "check parallelogram.yaml --poses 5",
                           "export parallelogram.yaml --format mjcf --out o.xml"],
}  # fmt: skip
EVERY = sorted({command for commands in COMMANDS.values() for command in commands})
DH = "joint,type,a [mm],alpha [deg],d [mm],theta [deg]\n1,revolute,100,90,50,0\n2,revolute,200,0,0,10\n"
CRANK = "a [deg],pin_x [mm],pin_y [mm],pin_z [mm]\n" + "".join(
    f"{angle},{500 * math.cos(math.radians(angle)) + 500 + 0.1 * (angle % 7)},{500 * math.sin(math.radians(angle))},0\n"
    for angle in range(20, 160, 9)
)


@pytest.fixture(scope="module")
def good(tmp_path_factory, run_calib):
    """A folder of good files: two robots, joint values, simulated measurements, targets, parameters, a result."""
    folder = tmp_path_factory.mktemp("good")
    write_arm(folder)
    write_parallelogram(folder, PARALLELOGRAM_YAML + "sigma: 0.5 mm\n")
    (folder / "crank.csv").write_text(CRANK)
    (folder / "dh.csv").write_text(DH)
    (folder / "p.csv").write_text("parameter,value,unit\nturn.x,1,mm\nslide.y,-0.5,mm\n")
    rows = [f"P{k},{(37 * k) % 100 / 50 - 1},{(53 * k) % 400 + 50},{(71 * k) % 300 - 150}" for k in range(24)]
    (folder / "joints.csv").write_text("pose,turn,slide [mm],wrist [deg]\n" + "\n".join(rows) + "\n")
    for command in (
        "simulate arm.yaml joints.csv --parameters p.csv --sigma-mm 0.05 --seed 4 --out data.csv",
        "fit arm.yaml data.csv --no-pages --sigma-mm 0.05 --force --out out",
        "predict arm.yaml joints.csv --out targets.csv",
    ):
        done = run_calib(*command.split(), cwd=folder)
        assert done.code in (0, 3), done
    assert (folder / "out" / "parameters.csv").is_file()
    return folder


@pytest.mark.quick(4)
@pytest.mark.parametrize("command", EVERY)
def test_what_is_edited_was_good(good, tmp_path, run_calib, command):
    done = keep_promises(run_calib, fresh(good, tmp_path), command.split())
    assert done.code == 0, done


def edits():
    """One edit: what to do, two places as fractions of the text, and something to put there."""
    kinds = ["token"] * 6 + ["cell"] * 3 + [
        "drop token", "swap tokens", "drop line", "double line", "swap lines", "drop column", "double column",
        "column", "cut", "bytes",
    ]  # fmt: skip
    place = st.integers(0, 99_999).map(lambda part: part / 100_000)
    number = st.one_of(st.sampled_from(["0", "-1", "1e-9", "1e5", "1e300", "nan", "90"]), st.floats(-2, 2).map(repr))
    anything = (st.floats().map(repr), st.integers(-(10**6), 10**6).map(str), st.text(max_size=6))
    atom = st.one_of(st.sampled_from(ATOMS), *anything)
    return st.one_of(
        st.tuples(st.just("number"), place, place, number), st.tuples(st.sampled_from(kinds), place, place, atom)
    )


def edited(source: bytes, steps) -> bytes:
    """The bytes of a file after some edits."""
    for kind, first, second, atom in steps:
        if kind in ("cut", "bytes"):
            at = int(first * len(source))
            rest = b"" if kind == "cut" else atom.encode("utf-16", "replace") + source[at:]
            source = source[:at] + rest
            continue
        text = source.decode("utf-8", "replace")
        how = "line" if "line" in kind else "column" if "column" in kind or kind == "cell" else "token"
        source = _EDITS[how](text, kind, first, second, atom).encode("utf-8", "replace")
    return source


def _edit_parts(parts, kind, first, second, atom):
    if not parts:
        return [atom]
    item, other = int(first * len(parts)), int(second * len(parts))
    if kind.startswith("drop"):
        del parts[item]
    elif kind.startswith("swap"):
        parts[item], parts[other] = parts[other], parts[item]
    elif kind.startswith("double"):
        parts.insert(other, parts[item])
    else:
        parts[item] = atom
    return parts


def _edit_tokens(text, *edit):
    parts = re.findall(r"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?|\w+|\W", text)
    if edit[0] == "number":
        places = [k for k, part in enumerate(parts) if part.lstrip("+-")[:1].isdigit()]
        if places:
            parts[places[int(edit[1] * len(places))]] = edit[3]
        return "".join(parts)
    return "".join(_edit_parts(parts, *edit))


def _edit_lines(text, *edit):
    return "\n".join(_edit_parts(text.split("\n"), *edit))


def _edit_columns(text, kind, first, second, atom):
    lines = text.split("\n")
    if kind == "cell":
        row = int(second * len(lines))
        lines[row] = ",".join(_edit_parts(lines[row].split(","), "cell", first, second, atom))
        return "\n".join(lines)
    return "\n".join(",".join(_edit_parts(line.split(","), kind, first, second, atom)) for line in lines if line)


_EDITS = {"token": _edit_tokens, "line": _edit_lines, "column": _edit_columns}


def fingerprint(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def _refuse(name):
    raise AssertionError(f"{name} in JSON")


_NUMBERS = re.compile(r"""\b(?:xyz|rpy|size|radius|length|scale|pos|quat|lower|upper|value)\s*=\s*["']([^"']*)""")
_TEXT_COLUMNS = {"pose", "parameter", "unit", "instrument", "setup", "state", "held", "status", "name"}


def numbers_that_are_none(path):
    """What in a written file stands where a finite number should; a result's own data are no text."""
    if path.suffix == ".npz":
        return []
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".json":
        json.loads(text, parse_constant=_refuse)
        return []
    if path.suffix == ".csv":
        lines = [line for line in text.splitlines() if not line.startswith("#")]
        rows = list(csv.DictReader(lines))
        cells = [
            cell for row in rows for name, cell in row.items() if name and name.split(" [")[0] not in _TEXT_COLUMNS
        ]
    else:
        cells = [cell for item in _NUMBERS.findall(text) for cell in item.split()]
    return [cell for cell in cells if cell and re.fullmatch(r"[-+]?(nan|inf|infinity)", cell.strip(), re.IGNORECASE)]


def _too_long(*_):
    raise TimeoutError(f"no end after {SECONDS} s")


@contextmanager
def bounded():
    """Let what runs inside take so much time and memory; more raises, and a program that catches it exits with 1."""
    before_signal = signal.signal(signal.SIGALRM, _too_long)
    before_limits = resource.getrlimit(resource.RLIMIT_AS)
    taken = psutil.Process().memory_info().vms
    resource.setrlimit(resource.RLIMIT_AS, (taken + MEMORY, before_limits[1]))
    signal.alarm(SECONDS)
    try:
        yield
    finally:
        signal.alarm(0)
        resource.setrlimit(resource.RLIMIT_AS, before_limits)
        signal.signal(signal.SIGALRM, before_signal)


def keep_promises(run_calib, folder, arguments):
    """Run `calib` in a folder and check what holds for every input."""
    before = fingerprint(folder)
    with bounded(), warnings.catch_warnings():
        warnings.simplefilter("error")
        done = run_calib(*arguments, cwd=folder)
    after = fingerprint(folder)
    said = done.out + done.err
    assert done.code in (0, 2, 3), (arguments, done)
    assert "Traceback" not in said
    assert "RuntimeWarning" not in said
    assert not re.search(r"^(calib: )?unexpected", said, re.MULTILINE), said
    assert all(letter.isprintable() or letter in "\n\t" for letter in done.err), done.err
    written = {name: content for name, content in after.items() if before.get(name) != content}
    if done.code == 2:
        assert done.err.count("\n") >= 1
        assert written == {}, (list(written), done.err)
        assert set(after) == set(before)
    if done.code == 0:
        none = {str(name): numbers_that_are_none(folder / name) for name in written}
        assert not any(none.values()), none
        assert not re.search(r"(?<![\w.'\"[-])[-+]?(nan|inf)(?![\w'\"\]])", done.out), done.out
    return done


def search(cases, check):
    """Try cases: the same few in the suite, as many others as CALIB_SEARCH says in a search."""
    hypothesis.settings(
        max_examples=SEARCHED or 6,
        derandomize=not SEARCHED,
        database=None,
        deadline=None,
        suppress_health_check=list(hypothesis.HealthCheck),
    )(hypothesis.given(cases)(check))()


def fresh(good, tmp_path):
    """The good files once more, in a folder of their own."""
    folder = tmp_path / "case"
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(good, folder)
    return folder


def test_a_run_that_takes_too_much_would_be_seen():
    with bounded(), pytest.raises(MemoryError):
        bytearray(MEMORY + 10**8)
    with bounded(), pytest.raises(TimeoutError, match="no end"):
        signal.raise_signal(signal.SIGALRM)


@pytest.mark.quick(0)
@pytest.mark.parametrize("name", COMMANDS)
def test_no_edit_of_a_file_breaks_a_promise(good, tmp_path, run_calib, name):
    def check(case):
        command, steps = case
        folder = fresh(good, tmp_path)
        (folder / name).write_bytes(edited((folder / name).read_bytes(), steps))
        keep_promises(run_calib, folder, command.split())

    search(st.tuples(st.sampled_from(COMMANDS[name]), st.lists(edits(), min_size=1, max_size=3)), check)


def test_no_options_break_a_promise(good, tmp_path, run_calib):
    def check(case):
        command, options = case
        more = [word if word != "''" else "" for option in options for word in option.split(" ")]
        keep_promises(run_calib, fresh(good, tmp_path), [*command.split(), *more])

    search(st.tuples(st.sampled_from(EVERY), st.lists(st.sampled_from(OPTIONS), max_size=3)), check)
