"""The same mistakes with every kind of measurement: one line that says where, exit code 2, no result, no traceback."""

import pytest

from tests.core.instruments.test_kind_pixel import INTRINSICS
from tests.six_axis_arm import write_six_axis

KINDS = {
    "position": "{kind: position, target: ball, sigma: 0.02 mm}",
    "pose": "{kind: pose, target: ball, sigma: 0.02 mm}",
    "orientation": "{kind: orientation, target: ball, rotation: rpy, sigma: 0.02 mrad}",
    "distance": "{kind: distance, target: ball, end: {frame: l0, xyz: [1, 0, 0]}, sigma: 0.02 mm}",
    "touch": "{kind: touch, target: ball, sigma: 0.02 mm, places: {hole: {frame: l0, xyz: [0.5, 0.2, 0.6]},"
    " hollow: {frame: l0, xyz: [0.5, -0.2, 0.6]}}}",
    "pixel": "{kind: pixel, target: ball, sigma: 0.3, camera: {frame: l0, xyz: [0, 0, 3], rpy: [180 deg, 0, 0], pose:"
    f" known}}, intrinsics: {INTRINSICS}, points: {{p: [0, 0, 0], q: [0.1, 0, 0]}}}}",
    "joint_reading": "{kind: joint_reading, joint: j3, sigma: 0.02 mrad}",
}
YAML = """\
urdf: arm.urdf
name_mot: [j1, j2, j3, j4, j5, j6]
base: {frame: l0}
targets: {ball: {frame: l6, xyz: [0.05, 0.02, 0.1]}}
instruments:
  seen: INSTRUMENT
parametrisation:
  - {origin: all, components: [x, y, z], sigma: 1 mm}
"""


def with_sigma(words, value):
    """The entry with its noise stated as this."""
    start = words.index("sigma: ") + len("sigma: ")
    stop = min(k for k in (words.find(",", start), words.find("}", start)) if k > 0)
    return words[:start] + value + words[stop:]


def check(run_calib, folder, entry):
    """The one line that a description with this entry is refused with."""
    return run_calib("check", write_six_axis(folder, YAML.replace("INSTRUMENT", entry))).refusal()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("noise", ["-1", "0", "3 degC", "3 furlong", "little", ".nan", ".inf"])
def test_noise_that_cannot_be_is_named(tmp_path, run_calib, kind, noise):
    line = check(run_calib, tmp_path, with_sigma(KINDS[kind], noise))
    assert "instruments.seen" in line
    assert "sigma" in line


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("{kind: ", "{kind: x", "unknown kind 'x"),
        ("kind: position, ", "", "instruments.seen"),
        ("sigma:", "sigme:", "unknown key 'instruments.seen.sigme'; did you mean 'sigma'"),
        (KINDS["position"], f"[{KINDS['position']}]", "instruments.seen"),
        (KINDS["position"], "", "instruments.seen"),
    ],
)
def test_an_entry_that_is_wrong_whatever_its_kind_is_named(tmp_path, run_calib, old, new, said):
    assert said in check(run_calib, tmp_path, KINDS["position"].replace(old, new, 1))


@pytest.mark.parametrize("kind", KINDS)
def test_a_file_without_a_column_of_the_instrument_is_refused(tmp_path, run_calib, kind):
    robot = write_six_axis(tmp_path, YAML.replace("INSTRUMENT", KINDS[kind]))
    (tmp_path / "data.csv").write_text("j1,j2,j3,j4,j5,j6,remark\n" + "0.1,0.2,0.3,0.4,0.5,0.6,1\n" * 12)
    run = run_calib("fit", robot, tmp_path / "data.csv", "--no-pages", "--out", tmp_path / "out")
    assert "seen" in run.refusal()
    assert not (tmp_path / "out").exists()
