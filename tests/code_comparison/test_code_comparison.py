"""The comparison of codes, run whole on simulated stand-ins for the data of others."""

import hashlib
import json
import os
import re

import numpy as np
import pinocchio as pin
import pytest
import scipy
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

pytest.importorskip("cv2", reason="OpenCV is not installed (extra 'camera')")
from tests.code_comparison.__main__ import main
from tests.code_comparison.arms import Arm, Chain
from tests.code_comparison.codes import CHAIN, CODES, HERE, PLACED, Code
from tests.code_comparison.codes import OURS as ALL_OURS
from tests.code_comparison.data_set import MissingDataError, Rows, Split
from tests.code_comparison.data_sets import DATA_SETS
from tests.code_comparison.data_sets.charuco_hand_eye import Images, Photographs, halves
from tests.code_comparison.data_sets.klipper_delta import Folds, Printers, Row, heights, left_out
from tests.code_comparison.data_sets.klipper_delta import read as read_printer
from tests.code_comparison.data_sets.motoman_pixels import Watched
from tests.code_comparison.data_sets.tilting_base import COLUMN, Stations
from tests.code_comparison.running import compared
from tests.photographs.camera_scenes import BOARD, CAMERA, scene
from tests.printers.test_printers import printer_cfg

pytestmark = pytest.mark.quick(0)

OURS, HAND_EYE, PRINTER = ALL_OURS["arm"], ALL_OURS["photographs"], ALL_OURS["printers"]
SHOWN = [code for code in CODES if code.name in (PLACED, OURS, "SciPy, priors", "robotkinecal")]
SHOWN += [code for code in CODES if code.problem != "arm" and not code.script.startswith("opencv")]
THOROUGH = os.environ.get("CALIB_TESTS") == "thorough"
STARTS = 25 if THOROUGH else 2
NOISE, ORIGINS = 2e-5, [(0, 0, 0.3), (0, 0.05, 0.2), (0.4, 0, 0), (0.3, 0.1, 0), (0, 0, 0.2), (0, 0.1, 0.1)]
TURNS = [(0, 0, 0), (np.pi / 2, 0, 0), (0, 0, 0), (0, np.pi / 2, 0), (np.pi / 2, 0, 0), (-np.pi / 2, 0, 0)]
JOINT = """<joint name="j{0}" type="revolute"><parent link="l{0}"/><child link="l{1}"/><origin xyz="{2}" rpy="{3}"/>
<axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint><link name="l{1}"/>"""
POINT = np.array([0.0, 0.03, 0.1])
PIXEL = 0.2
SIMULATED = dict.fromkeys(("robot", "instrument", "licence", "columns"), "simulated")
SIMULATED |= {"origin": "this test", "folder": "arm", "files": (), "digest": hashlib.sha256().hexdigest()}


def arm(errors):
    """URDF of an arm of six joints whose origins are off by errors (6, 6) [m, rad]."""
    turned = [
        pin.rpy.matrixToRpy(pin.rpy.rpyToMatrix(*t) @ pin.exp3(e[3:])) for t, e in zip(TURNS, errors, strict=True)
    ]
    moved = np.array(ORIGINS) + errors[:, :3]
    text = (" ".join(map(repr, map(float, row))) for pair in zip(moved, turned, strict=True) for row in pair)
    joints = "".join(JOINT.format(k, k + 1, next(text), next(text)) for k in range(6))
    return f'<robot name="arm"><link name="l0"/>{joints}</robot>'


def pose(turn, shift):
    """A pose (4, 4), turned by a rotation vector [rad]."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(turn).as_matrix(), shift
    return T


def watched(common, links, q, unseen):
    """A simulated arm whose markers two cameras see, as OpenCV has it; links: its last one, (n, 4, 4)."""
    cv2 = pytest.importorskip("cv2")
    rng, lens = np.random.default_rng(8), np.array([1500.0, 1490, 640, 500, -0.1, 0.05, 1e-3, -1e-3, 0.01])
    markers = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0.05]])
    own = pose([0.01, 0.02, 0.0], [0.0, 0.03, 0.1])
    cameras = [pose([0, -np.pi / 2, 0], [2.5, 0, 0.5]), pose([np.pi / 2, 0, 0], [0, 2.5, 0.5])]
    matrix = np.array([[lens[0], 0, lens[2]], [0, lens[1], lens[3]], [0, 0, 1]])
    rows = []
    for k, camera in enumerate(cameras):
        for joints, link in zip(q, links, strict=True):
            at = np.linalg.inv(camera) @ link @ own
            seen = cv2.projectPoints(markers, cv2.Rodrigues(at[:3, :3])[0], at[:3, 3], matrix, lens[4:])[0][:, 0]
            seen = seen + PIXEL * rng.standard_normal((3, 2))
            rows += [[*joints, k, *marker, *pixel] for marker, pixel in zip(markers, seen, strict=True)]
    table = np.array(rows)
    return Watched(
        "watched", splits=lambda _: [Split("40 poses", Rows(table[:, :6], table[:, 6:]), unseen)],
        T_link_markers=pose([0, 0, 0], [0.0, 0.03, 0.1]), lenses=lambda _: [lens, lens], **common,
    )  # fmt: skip


def photographs():
    """Simulated photographs of a board on a tool; the lens is not the published one."""
    view = scene(16, "base", seed=6, noise=PIXEL)
    images = Images(view.tool, tuple(np.split(view.body, 16)), tuple(np.split(view.pixels, 16)))
    camera, board = (
        (*T[:3, 3] + 0.02, *Rotation.from_matrix(T[:3, :3]).as_quat()) for T in (CAMERA["base"], BOARD["base"])
    )
    return Photographs(
        "shots", splits=lambda _: list(halves(images))[:1], camera=camera, board=board,
        intrinsics=(920.0, 930, 635, 490), size=view.size, **SIMULATED,
    )  # fmt: skip


def printer(folder):
    """A simulated delta whose probe reads 0.3 mm at 13 places; its settings are rounded."""
    text = printer_cfg(spans=False, noise=0.0, offset=0.3)
    rounded = re.sub(r"(radius|angle|endstop): ([\d.]+)", lambda m: f"{m[1]}: {float(m[2]):.0f}", text)
    (folder / "printer.cfg").write_text(rounded)
    folds = tuple(left_out(*read_printer(folder / "printer.cfg")))[:2]
    split = Split("two of 13 rows", *(Folds(folds, fitted, False) for fitted in (True, False)))
    return Printers("printer", splits=lambda _: [split], **SIMULATED)


@pytest.fixture(scope="module")
def stand_ins(tmp_path_factory):
    """A folder with simulated measurements, and data sets that say what is in it."""
    folder = tmp_path_factory.mktemp("data")
    rng = np.random.default_rng(4)
    (folder / "arm").mkdir()
    nominal, true = (arm(size * rng.standard_normal((6, 6))) for size in (0.0, 1e-3))
    (folder / "arm" / "arm.urdf").write_text(nominal)
    model = pin.buildModelFromXML(true)
    data = model.createData()

    def tip(q):
        pin.forwardKinematics(model, data, q)
        return data.oMi[6].act(POINT)

    q = rng.uniform(-2, 2, (140, 6))
    base = pin.SE3(pin.rpy.rpyToMatrix(0.1, 0.2, 2.0), np.array([1.0, -2.0, 0.3]))
    read = np.array([base.act(tip(row)) for row in q]) + NOISE * rng.standard_normal((140, 3))
    points, links = Rows(q, read), []
    for joints in q:
        pin.forwardKinematics(model, data, joints)
        links.append(data.oMi[6].homogeneous)
    touched, sockets = [], []
    for place, middle in enumerate(((0.6, 0.1, 0.5), (0.2, 0.6, 0.6), (0.1, -0.6, 0.4))):
        for hole in (0, 1):
            goal = np.array(middle) + (hole - 0.5) * 0.05 * np.array([0.6, 0.8, 0.0])
            ends = (
                least_squares(lambda x, goal=goal: tip(x) - goal, start)
                for start in rng.uniform(-1.5, 1.5, (STARTS, 6))
            )
            touched += [end.x for end in ends if end.cost < 1e-12]
            sockets += [[place, hole]] * (len(touched) - len(sockets))
    balls = Rows(np.array(touched), np.array(sockets, float))
    digest = hashlib.sha256((folder / "arm" / "arm.urdf").read_bytes()).hexdigest()
    common = SIMULATED | {
        "files": ("arm.urdf",), "digest": digest, "urdf": "arm.urdf", "base": "l0", "link": "l6",
        "joints": tuple(f"j{k}" for k in range(6)), "point": tuple(POINT), "point_sigma": 0.01,
    }  # fmt: skip
    rows = np.arange(140)
    here = balls.read[:, 0] == 2
    return folder, (
        Arm("points", splits=lambda _: [Split("60 rows", points[rows < 60], points[rows >= 60])], **common),
        Arm(
            "sockets",
            splits=lambda _: [Split("one place", balls[~here], balls[here])],
            spacing=0.05,
            **common,
        ),
        watched(common, links[:40], q[:40], points[rows >= 60]),
        photographs(),
        printer(folder),
    )


def compared_sets(sets):
    """All, or few: each code starts anew for each, which takes seconds."""
    return sets if THOROUGH else (sets[0], sets[4])


@pytest.fixture(scope="module")
def ran(stand_ins, tmp_path_factory):
    folder, sets = stand_ins
    out = tmp_path_factory.mktemp("out")
    (out / "page.md").write_text("Own words.\n\n<!-- begin results -->\nold\n<!-- end results -->\n\nMore.\n")
    given = [str(folder), "--results", str(out / "results.json"), "--page", str(out / "page.md")]
    assert main(given, compared_sets(sets), SHOWN) == 0
    rows = json.loads((out / "results.json").read_text())["rows"]
    return out, {(row["data"], row["code"]): row for row in rows}


def rms(row):
    return float(np.sqrt(np.mean(np.square(row["errors"]))))


@pytest.mark.amount(1, 3)
def test_codes_find_the_simulated_robot_in_rows_that_they_never_saw(ran, amount):
    """Of points; thorough, of sockets and of pixels, too."""
    _, rows = ran
    # beside noise: what 60 rows leave unknown of some 30 combinations, sqrt(1 + 30/180) times as much, up to half more
    for code in (OURS, "SciPy, priors"):
        assert NOISE < rms(rows["points", code]) / np.sqrt(3) < 1.5 * NOISE
        assert rms(rows["points", code]) < rms(rows["points", PLACED]) / 20
    # one least-squares problem, two programs that share no code
    assert rms(rows["points", OURS]) == pytest.approx(rms(rows["points", "SciPy, priors"]), rel=0.05)
    for name, least, alike in (("sockets", 3, np.inf), ("watched", 4, 0.05))[: amount - 1]:
        ours, plain, placed = (rms(rows[name, code]) for code in (OURS, "SciPy, priors", PLACED))
        assert max(ours, plain) < placed / least
        assert ours == pytest.approx(plain, rel=alike)


@pytest.mark.amount(0, 1)
def test_codes_find_a_simulated_camera(ran):
    _, rows = ran
    # two coordinates, and what eight images of 35 corners leave unknown of 18 numbers: a few per cent
    results = [rms(rows["shots", name]) / (np.sqrt(2) * PIXEL) for name in (HAND_EYE, "SciPy, lens found")]
    assert results == pytest.approx([1.0, 1.0], abs=0.1)
    assert rms(rows["shots", "SciPy, lens as published"]) > 5 * PIXEL
    assert rows["shots", HAND_EYE]["claimed_rms"] == pytest.approx(rms(rows["shots", HAND_EYE]), rel=0.2)


def test_codes_predict_a_simulated_printer(ran):
    _, rows = ran
    # steps of 0.01 mm are written to a thousandth; a row that is left out makes of that what the others allow
    assert all(max(rows["printer", name]["errors"]) < 1e-5 for name in (PRINTER, "Klipper, re-implemented"))


def test_a_shift_of_another_day_does_not_count(stand_ins):
    _, (*_, data) = stand_ins
    unseen = next(iter(data.splits(None))).unseen
    off = 3e-4 + np.array([1e-3, 4e-3])
    assert data.errors(unseen, off) == pytest.approx([1e-3, 4e-3])
    single = Folds((unseen.folds[0],) * 2, False, True)
    assert data.errors(single, off) == pytest.approx([0.0, 0.0])  # one row in a fold is its own mean


def test_heights_of_another_day_are_in_the_steps_of_the_file_that_is_fitted():
    rows = (Row(0.3, ("8,16,24",)), Row(64.7, ("1,2,3", "4,5,6")))
    (result,) = heights("microsteps: 16", rows, "x: 1\nmicrosteps: 64\n")
    assert result == Row(0.3, ("32.0,64.0,96.0",))


@pytest.mark.parametrize("code", CODES, ids=lambda code: f"{code.problem}: {code.name}")
def test_every_code_has_a_script_and_counts_the_lines_of_its_user(code):
    assert (HERE / code.script).is_file()
    assert code.problem in ALL_OURS
    assert code.lines > 0


def test_what_a_code_says_of_itself_and_costs_is_kept(ran):
    _, rows = ran
    ours, plain = rows["points", OURS], rows["points", "SciPy, priors"]
    assert ours["own_claim"]
    assert ours["verdict"] in ("PASS", "CHECK", "FAIL")
    assert ours["claimed_rms"] == pytest.approx(rms(ours), rel=0.3)  # 60 and 80 rows
    assert (plain["own_claim"], plain["verdict"]) == (False, None)
    assert all(0 < row["fit_seconds"] < row["command_seconds"] for row in (ours, plain))


def test_a_code_that_is_not_there_says_so_in_the_table(ran):
    out, rows = ran
    assert "robotkinecal==0.1.0" in rows["points", "robotkinecal"]["failed"]
    assert re.search(r"\| robotkinecal \| points.* \| not installed", (out / "page.md").read_text())


def test_the_page_keeps_its_own_words_and_can_be_written_again_without_a_run(ran, stand_ins):
    out, _ = ran
    page = (out / "page.md").read_text()
    assert page.startswith("Own words.\n")
    assert page.endswith("\nMore.\n")
    assert "\nold\n" not in page
    assert "points: 60 rows" in page
    assert (out / "figures" / "page.svg").read_text().count("<text") > 4
    again = ["--results", str(out / "results.json"), "--page", str(out / "page.md")]
    assert main(again, compared_sets(stand_ins[1]), SHOWN) == 0
    assert (out / "page.md").read_text() == page


def test_the_page_says_which_codes_ran_elsewhere_or_at_another_time(ran, stand_ins, tmp_path):
    out, _ = ran
    told = json.loads((out / "results.json").read_text())
    machines = {row["machine"] for row in told["rows"]}
    assert len(machines) == 1
    assert f"\n{machines.pop()}.\n" in (out / "page.md").read_text()
    for row in told["rows"]:
        row["machine"] = "Last year" if row["code"] == "SciPy, priors" else "Today"
    (tmp_path / "results.json").write_text(json.dumps(told))
    (tmp_path / "page.md").write_text("<!-- begin results -->\n<!-- end results -->\n")
    given = ["--results", str(tmp_path / "results.json"), "--page", str(tmp_path / "page.md")]
    assert main(given, compared_sets(stand_ins[1]), SHOWN) == 0
    page = (tmp_path / "page.md").read_text()
    assert "\nLast year: SciPy, priors.\n" in page
    assert f"\nToday: {PLACED}, {OURS}, " in page


def test_an_environment_that_pip_cannot_fill_goes_away(stand_ins, tmp_path):
    folder, (points, *_) = stand_ins
    absent = Code("absent", "scipy_origins.py", key="absent", requires=(str(tmp_path / "none.whl"),), shared=CHAIN)
    given = [str(folder), "--results", str(tmp_path / "results.json"), "--environments", str(tmp_path), "--install"]
    assert main(given, [points], [absent]) == 0
    assert not (tmp_path / "absent").exists()
    (row,) = json.loads((tmp_path / "results.json").read_text())["rows"]
    assert row["failed"] == f"not installed ({tmp_path / 'none.whl'})"


def test_other_files_than_those_published_are_refused(stand_ins, tmp_path, capsys):
    _, (points, *_) = stand_ins
    with pytest.raises(MissingDataError, match=r"arm\.urdf is missing; take it from this test"):
        points.checked(tmp_path)
    (tmp_path / "arm").mkdir()
    (tmp_path / "arm" / "arm.urdf").write_text("<robot/>")
    with pytest.raises(MissingDataError, match="other data than here"):
        points.checked(tmp_path)
    assert main([str(tmp_path), "--results", str(tmp_path / "none.json")], [points], SHOWN) == 2
    assert "other data than here" in capsys.readouterr().err


def test_differences_are_ties_unless_they_are_sure_and_large():
    rng = np.random.default_rng(0)
    errors = np.abs(rng.standard_normal(400))
    assert compared(errors, errors, 1e-3) == "tie"
    assert compared(errors, 1.2 * errors, 1e-3) == "better"
    assert compared(errors, errors / 1.2, 1e-3) == "worse"
    assert compared(errors, 1.004 * errors, 1e-3) == "tie"  # sure, and of no weight
    assert compared(errors, np.abs(rng.standard_normal(400)), 1e-3) == "tie"  # others of the same size
    few, off = np.array([1.0, 1, 1, 1]), np.array([2.0, 2, 3, 4])
    level = scipy.stats.ttest_rel(off**2, few**2).pvalue
    assert [compared(few, off, chance) for chance in (0.99 * level, 1.01 * level)] == ["tie", "better"]


def test_errors_of_sockets_are_what_no_place_of_the_artefact_explains(stand_ins):
    _, (_, sockets, *_) = stand_ins
    line, off = np.array([0.0, 0.6, 0.8]), 1e-3 * np.array([[1.0, 0, 0], [-1, 0, 0]])
    read = np.array([[0, 0], [0, 0], [0, 1], [0, 1]], float)
    points = np.array([1.0, 2, 3]) + 0.05 * read[:, 1:] * line + np.vstack([off, off])
    assert sockets.errors(Rows(np.zeros((4, 6)), read), points) == pytest.approx(1e-3, rel=1e-6)
    apart = np.array([1.0, 2, 3]) + 0.052 * read[:, 1:] * line  # 2 mm too far apart: half at each
    assert sockets.errors(Rows(np.zeros((4, 6)), read), apart) == pytest.approx(1e-3, rel=1e-6)


def stations(name="stations"):
    return Stations(name, splits=lambda _: [], joints=(COLUMN,), base="foot", link="tip", **SIMULATED)


def test_an_arm_that_tilts_is_placed_anew_at_each_height():
    rng = np.random.default_rng(2)
    height, places = np.repeat([0.0, 1.0], 10), np.tile(np.arange(10) < 6, 2)
    points = rng.uniform(-1, 1, (20, 3))
    off = np.where(places, 0.0, 1e-3)[:, None] * [0.0, 0.6, 0.8]
    tilted = [pose([0.1 * k, 0, 0], [k, 2, 3]) for k in (1, 2)]
    read = np.vstack([points[height == k] @ tilted[k][:3, :3].T + tilted[k][:3, 3] for k in (0, 1)])
    unseen = Rows(np.zeros((20, 1)), np.column_stack([read, height, places]))
    assert stations().errors(unseen, points + off) == pytest.approx(np.full(8, 1e-3))


def test_a_column_of_two_segments_is_a_joint(tmp_path):
    def segment(name, parent, child, offset=None):
        mimic = f'<mimic joint="column_prismatic_joint" multiplier="0.5" offset="{offset}"/>' if offset else ""
        return (
            f'<joint name="{name}" type="prismatic"><parent link="{parent}"/><child link="{child}"/>{mimic}'
            '<origin xyz="0 0 0"/><axis xyz="0 0 1"/><limit lower="0" upper="1" effort="1" velocity="1"/></joint>'
            f'<link name="{child}"/>'
        )

    parts = segment("column_prismatic_joint", "foot", "column_pseudo_tip")
    parts += segment("column_middle_joint", "foot", "middle", -0.7) + segment(COLUMN, "middle", "tip", -0.8)
    (tmp_path / "two.urdf").write_text(f'<robot name="column"><link name="foot"/>{parts}</robot>')
    stations().nominal(tmp_path / "two.urdf").write(tmp_path / "one.urdf")
    poses = Chain(tmp_path / "one.urdf", "foot", "tip", [COLUMN]).poses(np.array([[2.0], [3.5]]))
    assert poses[:, 2, 3] == pytest.approx([0.5, 2.0])  # 2 (q / 2) - 0.7 - 0.8


def test_the_splits_of_all_data_sets_keep_fitted_and_unseen_rows_apart(shared_data):
    for data in DATA_SETS:
        for split in data.splits(data.checked(shared_data)):
            fitted, unseen = split.train.keys(), split.unseen.keys()
            least = 5  # images, rows of printers, poses of the smallest set
            assert len(fitted) > least
            assert len(unseen) > least
            assert not fitted & unseen, f"{data.name}: {split.words}"
