"""The robot description: what it says is done; every mistake is one line with the place and the nearest valid name."""

import numpy as np
import pytest

import calib
from calib.core.base.errors import InputError
from calib.core.robots.description import description_yaml, read_description
from tests.small_robots import ARM_URDF, ARM_YAML, PARALLELOGRAM_YAML, write_arm, write_parallelogram


def complaint(path):
    with pytest.raises(InputError) as caught:
        calib.load(path)
    assert caught.value.exit_code == 2
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(str(path))
    return message.removeprefix(str(path)).lstrip(": ")


def test_lengths_and_angles_may_carry_units(tmp_path):
    yaml = ARM_YAML.replace("{frame: ground}", "{frame: ground, xyz: [1 mm, 2 um, 0.5], rpy: [90 deg, 1 mrad, 0.25]}")
    description = read_description(write_arm(tmp_path, yaml + "sigma: 40 um\nhome: {slide: 3 mm}\n"))
    assert description.base.xyz == (0.001, 2e-6, 0.5)
    assert description.base.rpy == (np.pi / 2, 0.001, 0.25)
    assert description.sigma == 40e-6
    assert description.targets["tip"].xyz == (0.01, 0.02, 0.03)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[10 mm, 20 mm, 30 mm]", "[100, 20, 30]", "targets.tip.xyz[0]: 100 m is not plausible; write the unit after"),
        ("base: {frame: ground}", "base: {frame: ground, rpy: [0, 90, 0]}", "base.rpy[1]: 90 rad is not plausible"),
        ("urdf:", "home: {turn: 90}\nurdf:", "home.turn: 90 rad is not plausible; write the unit after the number"),
    ],
)
def test_a_number_without_a_unit_that_cannot_be_si_is_refused(tmp_path, old, new, said):
    assert complaint(write_arm(tmp_path, ARM_YAML.replace(old, new))).startswith(said)


def test_a_long_length_reads_back(tmp_path):
    path = write_arm(tmp_path, ARM_YAML.replace("{frame: ground}", "{frame: ground, xyz: [60 m, 0, 0]}"))
    description = read_description(path)
    path.write_text(description_yaml(description))
    assert read_description(path) == description


def test_yaml_anchors_and_merges_work(tmp_path):
    yaml = ARM_YAML.replace(
        "  tip: {frame: tool, xyz: [10 mm, 20 mm, 30 mm]}",
        "  tip: &tip {frame: tool, xyz: [10 mm, 20 mm, 30 mm]}\n  elbow: {<<: *tip, frame: slider}",
    )
    targets = read_description(write_arm(tmp_path, yaml)).targets
    assert targets["elbow"].frame == "slider"
    assert targets["elbow"].xyz == targets["tip"].xyz


def test_a_column_may_be_called_no(tmp_path):
    described = read_description(write_arm(tmp_path, ARM_YAML + "columns: {No: pose}\npriors: no\n"))
    assert described.columns == {"No": "pose"}
    assert described.priors is False


def test_a_byte_order_mark_and_windows_line_ends_are_fine(tmp_path):
    path = write_arm(tmp_path)
    path.write_bytes(b"\xef\xbb\xbf" + ARM_YAML.replace("\n", "\r\n").encode())
    assert calib.load(path).joint_names == ("turn", "slide", "wrist")


YAML_MISTAKES = {
    "target twice": ("tip:", "tip:\n  tip:", "key 'tip' is given twice"),
    "twice": ("arm.urdf", "arm.urdf\nurdf: other.urdf", "line 2: not valid YAML (key 'urdf' is given twice)"),
    "tab": ("base:", "\tbase:", "line 3: not valid YAML (found character '\\t' that cannot start any token)"),
    "braces": ("arm.urdf", "{{ robot }}", "line 1: not valid YAML (a key is a list or a mapping)"),
    "no such date": ("10 mm, 20 mm", "2020-13-45, 20 mm", "not valid YAML (month must be in 1..12)"),
    "control code": ("arm.urdf", "arm\x07.urdf", "not valid YAML (special characters are not allowed)"),
    "depth": ("arm.urdf", "[" * 5000, "not valid YAML (maximum recursion depth exceeded"),
    "python": ("arm.urdf", "!!python/name:os.system", "line 1: not valid YAML (could not determine a constructor"),
}


@pytest.mark.quick(1)
@pytest.mark.parametrize(("old", "new", "message"), YAML_MISTAKES.values(), ids=YAML_MISTAKES)
def test_broken_yaml_is_an_error_with_its_line(tmp_path, old, new, message):
    assert message in complaint(write_arm(tmp_path, ARM_YAML.replace(old, new)))


KEY_MISTAKES = {
    "unknown key": ("name_mot:", "name_mott:", "unknown key 'name_mott'; did you mean 'name_mot'?"),
    "far from any": ("urdf: arm.urdf", "urdf: arm.urdf\nqqq: 1", "unknown key 'qqq'; valid: base, closed_loop, "),
    "base": ("base: {frame: ground}", "base: {frame: ground, xzy: [0, 0, 0]}", "unknown key 'base.xzy'; did you mean"),
    "target": ("{frame: tool,", "{frme: tool,", "unknown key 'targets.tip.frme'; did you mean 'frame'?"),
    "target named str": ("tip: {frame:", "str: {fram:", "unknown key 'targets.str.fram'; did you mean 'frame'?"),
    "entry": ("components:", "component:", "unknown key 'parametrisation[0].component'; did you mean 'components'?"),
    "noise": ("urdf:", "sigma: {range: 1 mm, angl: 1 mrad}\nurdf:", "unknown key 'sigma.angl'; did you mean 'angle'?"),
    "fleet": ("urdf:", "fleet: {robot: 3}\nurdf:", "unknown key 'fleet.robot'; did you mean 'robots'?"),
    "missing": ("urdf: arm.urdf\n", "", "key 'urdf' is missing"),
    "missing in a list": ("origin: all, components: [x", "components: [x", "key 'parametrisation[0].origin' is"),
    "number as key": ("urdf: arm.urdf", "urdf: arm.urdf\n3: 4", "key 3 should be text; put it in quotes"),
    "truth as key": ("tip:", "true:", "key True should be text; put it in quotes"),
}  # fmt: skip


VALUE_MISTAKES = {
    "joint as number": ("[turn,", "[1,", "name_mot[0]: should be text; put it in quotes (given: 1)"),
    "one joint, no list": ("[turn, slide, wrist]", "turn", "name_mot: should be a list, such as [a, b] (given:"),
    "no joint": ("[turn, slide, wrist]", "[]", "name_mot: should have at least 1 entries, not 0"),
    "base as text": ("{frame: ground}", "ground", "base: should be keys and values, such as {frame: base_link}"),
    "two coordinates": ("[10 mm, 20 mm, 30 mm]", "[10 mm, 20 mm]", "targets.tip.xyz: entry 3 is missing"),
    "four coordinates": ("30 mm]", "30 mm, 40 mm]", "targets.tip.xyz: should have at most 3 entries, not 4"),
    "angle for a length": ("30 mm]", "30 deg]", "targets.tip.xyz[2]: unit 'deg' is for an angle; a length is expected"),
    "nan": ("30 mm]", ".nan]", "targets.tip.xyz[2]: nan is not a finite number with a unit, such as '0.04 mm'"),
    "true": ("sigma: 2 mm", "sigma: true", "parametrisation[0].sigma: True is not a number with a unit"),
    "word": ("ground}", "ground, pose: unkown}", "base.pose: unknown value 'unkown'; did you mean 'unknown'?"),
    "component": ("[x, y, z]", "[x, yy, z]", "parametrisation[0].components[1]: unknown value 'yy'; did you mean 'y'?"),
    "mixed": ("[x, y, z]", "[x, ry, z]", "parametrisation[0]: lengths (x, y, z) and angles (rx, ry, rz) need entries"),
    "sigma of a known target": ("30 mm]}", "30 mm], sigma: 1 mm}", "targets.tip: sigma is for a target whose position"),
    "negative sigma": ("urdf:", "sigma: -1 mm\nurdf:", "sigma: should be greater than 0 (given: '-1 mm')"),
    "limit": ("urdf:", "singularity_limit: 2\nurdf:", "singularity_limit: should be less than 1 (given: 2)"),
    "type without loop": ("urdf:", "type: [3d]\nurdf:", "'type' has 1 entries for 0 entries of 'closed_loop'"),
    "axes without loop": ("urdf:", "closed_loop_axes: [[x]]\nurdf:", "'closed_loop_axes' has 1 entries for 0 entries"),
}  # fmt: skip


@pytest.mark.parametrize("content", ["", "# only a comment\n", "- a\n- b\n", "just text\n", "7\n"])
def test_a_file_that_is_no_mapping_is_an_error(tmp_path, content):
    assert complaint(write_arm(tmp_path, content)).startswith("is not a mapping of keys to values; `calib init URDF`")


def test_files_that_cannot_be_read_are_errors(tmp_path):
    path = write_arm(tmp_path)
    said = "no such file or folder; give a robot description (YAML), a URDF or a result folder"
    assert complaint(tmp_path / "no.yaml") == said
    (tmp_path / "folder.yaml").mkdir()
    assert complaint(tmp_path / "folder.yaml").startswith("holds no result")
    path.write_bytes(ARM_YAML.encode("utf-16"))
    assert complaint(path) == "is not UTF-8 text; give a robot description (YAML) or a URDF in UTF-8"


URDF_MISTAKES = {
    "actuated": ("[turn,", "[turm,", "name_mot: no joint 'turm'; did you mean 'turn'?"),
    "fixed actuated": ("[turn,", "[flange,", "name_mot: joint 'flange' is fixed, it does not move"),
    "actuated twice": ("[turn,", "[turn, turn,", "'name_mot' names 'turn' twice"),
    "order": ("urdf:", "elimination_order: [turn.w]\nurdf:", "elimination_order: no parameter 'turn.w'; 'turn' has"),
    "columns": ("urdf:", "columns: {a: turn, b: turn}\nurdf:", "columns: 'a' and 'b' both stand for 'turn'"),
    "base": ("{frame: ground}", "{frame: grund}", "base.frame: no link or joint 'grund'; did you mean 'ground'?"),
    "target": ("{frame: tool,", "{frame: tol,", "targets.tip.frame: no link or joint 'tol'; did you mean 'tool'?"),
    "home": ("urdf:", "home: {slid: 0}\nurdf:", "home: no moving joint 'slid'; did you mean 'slide'?"),
    "home fixed": ("urdf:", "home: {flange: 0}\nurdf:", "home: no moving joint 'flange'"),
    "home unit": ("urdf:", "home: {slide: 3 deg}\nurdf:", "home.slide: unit 'deg' is for an angle; a length is"),
    "held": ("urdf:", "held: [turn.w]\nurdf:", "held: no parameter 'turn.w'; 'turn' has"),
    "origin": ("origin: all, components: [x", "origin: wirst, components: [x", "parametrisation: no joint origin"),
    "unit": ("sigma: 2 mm", "sigma: 2 mm, unit: inch", "parametrisation: turn.x, unit: unknown unit 'inch'; valid: m,"),
    "sigma": ("sigma: 2 mm", "sigma: 2 mrad", "parametrisation: turn.x, sigma: unit 'mrad' is for an angle; a length"),
    "zero sigma": ("sigma: 2 mm", "sigma: 0", "parametrisation: turn.x: sigma must be positive; leave a component out"),
    "all twice": ("[rx, ry, rz]", "[rx, ry, rx]", "parametrisation: 'turn.rx' is listed twice"),
    "column": ("urdf:", "columns: {X: tip_w}\nurdf:", "columns.X: no column 'tip_w'; did you mean 'tip_"),
    "column unit": ("urdf:", "columns: {X: 'tip_x [deg]'}\nurdf:", "columns.X: unit 'deg' is for an angle; a length"),
}  # fmt: skip


MISTAKES = [*KEY_MISTAKES.items(), *VALUE_MISTAKES.items(), *URDF_MISTAKES.items()]


@pytest.mark.parametrize(("old", "new", "message"), [row for _, row in MISTAKES], ids=[name for name, _ in MISTAKES])
def test_a_wrong_key_value_or_name_is_an_error_with_the_nearest_valid_one(tmp_path, old, new, message):
    assert ARM_YAML.count(old) >= 1
    assert complaint(write_arm(tmp_path, ARM_YAML.replace(old, new, 1))).startswith(message)


def test_a_place_that_is_unknown_is_not_listed_as_well(tmp_path):
    yaml = ARM_YAML.replace("{frame: ground}", "{frame: ground, pose: unknown}")
    yaml += "  - {origin: base, components: [x], sigma: 1 mm}\n"
    assert complaint(write_arm(tmp_path, yaml)) == (
        "parametrisation: 'base.x' is listed twice; leave it out: an unknown base or target is free anyway"
    )


@pytest.mark.parametrize(
    ("base", "message"),
    [
        ("ground, pose: unknown", "set base.pose and targets.*.position to"),
        ("ground", "no parametrisation 'scara' is installed"),
    ],
)
def test_a_named_parametrisation_must_be_installed_and_brings_its_own_base(tmp_path, base, message):
    yaml = ARM_YAML.replace("frame: ground", f"frame: {base}").partition("parametrisation:")[0]
    assert message in complaint(write_arm(tmp_path, yaml + "parametrisation: scara\n"))


def test_names_that_a_joint_has_already_get_other_origins(tmp_path):
    urdf = ARM_URDF.replace('"flange"', '"base"').replace('"slide"', '"tip"').replace('"wrist"', '"tip_point"')
    yaml = ARM_YAML.replace("[turn, slide, wrist]", "[turn, tip, tip_point]")
    robot = calib.load(write_arm(tmp_path, yaml, urdf))
    names = robot.mechanism.origin_names
    assert names == ("turn", "tip", "tip_point", "base", "measurement_base", "tip_point_")
    plain = calib.load(write_arm(tmp_path))
    q = [0.3, 0.2, -0.4]
    assert np.array_equal(robot.positions(q), plain.positions(q))


@pytest.mark.parametrize("axes", ["[x, y, rz]", "[rz, y, x]"])
def test_a_loop_of_whole_frames_closes_rotations_too(tmp_path, axes):
    yaml = PARALLELOGRAM_YAML.replace("3d", "6d").replace("[[x, y]]", f"[{axes}]")
    yaml = yaml.replace("c: 90 deg", "c: 90 deg, d: 1.5708")
    robot = calib.load(write_parallelogram(tmp_path, yaml, turning_end=True))
    a = np.linspace(0.2, 2.9, 7)
    passive = robot.assemble(a[:, None]).passive
    assert robot.passive_names == ("c", "b", "d")
    assert np.abs(passive - np.stack([a, -a, a], axis=1)).max() < 1e-12


LOOP_MISTAKES = {
    "open": ("b: -90 deg", "b: -80 deg", "home: loop rocker_end-coupler_end is open by 174.311 mm"),
    "no value": (", c: 90 deg", "", "home: gives no value for joint 'c'; a robot with loops needs an assembled"),
    "stretched": ("{a: 90 deg, b: -90 deg, c: 90 deg}", "{a: 0, b: 0, c: 0}", "home: the closures do not determine"),
    "frame": ("rocker_end, coupler_end", "rocker_edn, coupler_end", "closed_loop[0]: no link or joint 'rocker_edn';"),
    "too many": ("[[x, y]]", "[[x, y, z]]", "the closures constrain 3 directions but leave 2 passive joints (c, b)"),
    "too few": ("[[x, y]]", "[[x]]", "the closures constrain 1 direction but leave 2 passive joints (c, b)"),
    "unmoved direction": ("[[x, y]]", "[[x, z]]", "home: the closures do not determine the passive joints"),
    "all axes of 3d": ("closed_loop_axes: [[x, y]]\n", "", "the closures constrain 3 directions but leave 2 passive"),
    "rotation of points": ("[[x, y]]", "[[x, rz]]", "closed_loop[0]: axis 'rz' is a rotation; that needs type 6d"),
    "axis twice": ("[[x, y]]", "[[x, x]]", "closed_loop[0]: closed_loop_axes ['x', 'x'] must name each direction once"),
    "no axis": ("[[x, y]]", "[[]]", "closed_loop[0]: closed_loop_axes [] must name each direction once, at least one"),
    "actuated twice over": ("name_mot: [a]", "name_mot: [a, b]", "the closures constrain 2 directions but leave 1"),
}  # fmt: skip


@pytest.mark.parametrize(("old", "new", "message"), LOOP_MISTAKES.values(), ids=LOOP_MISTAKES)
def test_loops_that_cannot_be_right_are_errors(tmp_path, old, new, message):
    assert PARALLELOGRAM_YAML.count(old) >= 1
    assert complaint(write_parallelogram(tmp_path, PARALLELOGRAM_YAML.replace(old, new, 1))).startswith(message)
