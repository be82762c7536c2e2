"""What someone types who is fluent in lmfit, scikit-learn, SciPy, pandas, Pinocchio or ROS runs, or names the way."""

import importlib
import json
import re
import shutil
import sys

import click
import numpy as np
import pytest

import calib
from calib.cli import group, main
from calib.core.base.other_words import tables
from tests.project import EXAMPLES
from tests.whole.conftest import ARM, READ

ANSWERED = {
    # lmfit and SciPy
    "t.fit.verdict.status": ".grade",
    "calib.fit(t.robot, t.data, terms='stiffness')": "here: compliance",
    "calib.fit(t.robot, t.data, free=['joint_3.z'])": "also give fix='all'",
    # what is left out, or comes in another order
    "calib.fit(READ, ARM)": "the robot comes first",
    "calib.robot(ARM)": "calib.load(",
    "calib.verify('folder', t.data)": "calib.load_result(folder)",
    "calib.verify(t.robot, t.data)": "not Robot",
    # arguments of a wrong type
    "t.fit.cross_validate(1.5)": "1.5",
    "t.robot.fix(3)": "named by text",
    "t.fit.covariance['joint_3.z']": "takes two names",
    # scikit-learn
    "calib.fit(t.robot, {'q': t.q})": "calib.as_measurements(robot, q, xyz)",
    "calib.compare(t.robot, t.fit.robot)": "fit.to_dataframe()",
    "calib.URDF('x.urdf')": "calib.load",
    "calib.fit(t.robot, t.data, prior={'joint_3.z': 0.5})": "has no unit",
    "calib.fit(t.robot, t.q)": "calib.as_measurements(robot, q, xyz)",
    "calib.fit(t.robot, t.data, free='offsets')": "joint-offsets",
    "calib.fit(t.robot, t.data, prior={'length': '1 mm'})": "sigma",
    # pandas and matplotlib
    "t.data['reflector_x']": "data.to_dataframe()",
    # Pinocchio, ROS, roboticstoolbox
    "calib.read_measurements(t.robot, READ)": "the data come first here",
    "t.robot.forward(READ)": "expected numbers",
    "calib.solve(t.fit, 'goals.csv')": "goals: expected numbers",
    "t.robot.joint_name": "did you mean 'joint_names'",
    "calib.fit(t.fit, t.data)": "expected a Robot",
    # what Python asks of everything
    "t.fit.verdict == 'PASS'": "fit.verdict.grade == 'PASS'",
    # what is given is of another kind
    "t.robot.joint_limits['joint_9']": "did you mean 'joint_6'",
    "t.robot.parameters['joint_2.offset']": "'joint_2' has joint_2.rx, joint_2.ry, joint_2.rz, joint_2.x",
    "t.robot.forward({'joint_1': 0.1})": "[values[name] for name in robot.joint_names]",
    "t.robot.forward(np.eye(4))": "calib.solve(robot, poses)",
    "t.robot.save('c2.urdf')": "calib.export(robot, 'c2.urdf', 'urdf')",
    "calib.simulate(t.robot, 30)": "robot.sample(30, seed=1)",
    "t.data + t.data": "calib.fit(robot, [first, 'b.csv'])",
    "t.fit.residuals['tool']": "valid: reflector",
    "t.fit.predict(t.q) - t.q[:, :3]": "give an array of shape (5, 1, 3)",
    "calib.fit(t.robot, t.data, prior={'joint_2.x': (0, 0.001)})": "not a standard deviation with its unit",
    "bool(t.fit.verdict)": "fit.verdict.grade == 'PASS'",
    "t.fit.save(t.folder / 'fit.pkl')": "leave the ending out",
    "calib.load(str(EXAMPLES / 'five_bar.yaml')).params": 'robot.parameters["left_motor.x"]',
    "t.fit.errors['test']": "valid: identification, validation",
    "calib.solve(t.robot, t.data.points()[:3, 0]).require_all()": "where the robot description has them",
}
"""Lines of other packages, some of each place, and what the error names; the words are one table, tested below."""


@pytest.mark.parametrize("typed", ANSWERED)
def test_a_word_of_another_package_is_answered_with_the_way(t, typed):
    with pytest.raises(calib.InputError) as caught:
        eval(typed, {"calib": calib, "np": np, "t": t, "READ": READ, "ARM": ARM, "EXAMPLES": EXAMPLES})
    assert ANSWERED[typed] in str(caught.value)
    assert "\n" not in str(caught.value)


def test_every_word_of_the_table_is_answered_with_its_way(t):
    for owner, place in (
        (t.fit, t.fit._other_words),
        (t.robot, t.robot._other_words),
        (t.data, t.data._other_words),
        (t.fit.verdict, t.fit.verdict._other_words),
        (calib, "`calib` itself"),
    ):
        for row in tables()[place]:
            for word in set(row.words) - {"calibration"}:  # which is a module, too
                with pytest.raises(calib.InputError) as caught:
                    getattr(owner, word)
                assert row.here.replace("`", "") in str(caught.value), word


def test_what_is_asked_for_politely_is_not_there(t):
    assert not hasattr(t.robot, "fk")
    assert not hasattr(t.fit, "params")
    assert not hasattr(calib, "minimize")
    assert getattr(t.fit, "params", None) is None


def test_an_error_inside_an_attribute_is_not_taken_for_its_absence(t, monkeypatch):
    monkeypatch.setattr(type(t.robot), "home", property(lambda self: self.urdf.nothing_of_this_name))
    with pytest.raises(AttributeError, match="nothing_of_this_name"):
        _ = t.robot.home


def test_the_jacobian_is_the_derivative_of_the_pose(t):
    for name, frame in (
        (ARM, "flange"),
        (str(EXAMPLES / "five_bar.yaml"), None),
        (str(EXAMPLES / "stewart.yaml"), None),
    ):
        robot = calib.load(name)
        q, step = robot.sample(2, seed=3), 1e-6
        jacobian = robot.jacobian(q, frame)
        for k in range(len(robot.joint_names)):
            ahead, behind = (
                robot.forward(q + sign * step * np.eye(len(robot.joint_names))[k], frame) for sign in (1, -1)
            )
            change = (ahead - behind) / (2 * step)
            turn = change[:, :3, :3] @ robot.forward(q, frame)[:, :3, :3].transpose(0, 2, 1)
            rate = np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1)
            np.testing.assert_allclose(jacobian[:, :3, k], change[:, :3, 3], atol=1e-7)  # differences: 1e-6^2
            np.testing.assert_allclose(jacobian[:, 3:, k], rate, atol=1e-7)


def test_rows_that_are_said_to_be_worse_count_less(t):
    sigma = np.full(80, 3e-5)
    sigma[:40] = 3e-2
    weighed = calib.fit(t.robot, t.data, sigma=sigma)
    rest = calib.fit(t.robot, t.data[40:], sigma=3e-5)
    spread = np.sqrt(np.diagonal(np.asarray(rest.covariance)))
    assert np.max(np.abs((weighed.robot.values - rest.robot.values)[rest.free]) / spread) < 0.1


@pytest.mark.parametrize(
    ("sigma", "words"),
    [
        (np.ones(3), "expected (80,)"),
        (np.zeros(80), "positive"),
        *((sigma, "must be a positive number") for sigma in (0.0, -1e-4, np.nan, np.inf)),
        ("1 deg", "is for an angle"),
        ("x", "not a finite"),
    ],
)
def test_noise_that_makes_no_sense_is_told(t, sigma, words):
    with pytest.raises(calib.InputError, match=re.escape(words)):
        calib.fit(t.robot, t.data, sigma=sigma)


def test_a_table_in_memory_is_checked_like_a_file(t):
    columns = t.data.to_dict()
    with pytest.raises(calib.DataError, match="line 2, column 'joint_1': 'x' is not a number"):
        calib.read_measurements(columns | {"joint_1 [deg]": [0.0, "x", *[0.0] * 78]}, t.robot)
    with pytest.raises(calib.DataError, match="column 'joint_2 \\[deg\\]' has 3 cells, and others 80"):
        calib.read_measurements(columns | {"joint_2 [deg]": [0.0] * 3}, t.robot)
    with pytest.raises(calib.InputError, match="is a folder; the robot of a result is"):
        calib.check(str(EXAMPLES), t.q)
    with pytest.raises(calib.InputError, match="its ending does not say the format"):
        t.fit.export("robot.yaml")


def test_every_word_stands_once_in_its_place():
    for place, rows in tables().items():
        words = [word for row in rows for word in row.words]
        assert len(words) == len(set(words)), (place, [word for word in words if words.count(word) > 1])


def test_what_the_table_names_is_there(t):
    of = {"fit": t.fit, "robot": t.robot, "data": t.data, "calib": calib}
    for rows in tables().values():
        for row in rows:
            for owner, name in re.findall(r"\b(fit|robot|data|calib)\.(?!yaml|csv)([a-z_]+)", row.here):
                assert hasattr(of[owner], name), row.here


@pytest.mark.parametrize(
    ("typed", "words"),
    [
        (["fit", ARM, READ, "--robust"], "--loss huber"),
        (["fit", ARM, READ, "--output", "x"], "here: --out"),
        (["fit", ARM, READ, "--bounds", "1"], "there are no bounds"),
        (["calibrate", ARM, READ], "calib fit ROBOT DATA --out DIR"),
        (["plot", ARM], "calib view ROBOT"),
        (["fit", ARM, READ, "--tool", "tcp"], "no option '--tool'; here: the robot description: targets:"),
        (["demo"], "no command 'demo'; here: medrue demo"),
        (["fit", ARM, READ, "--compliance"], "--terms auto"),
        (["fit", ARM, READ, "--confidence", "0.9"], "95 %"),
        (["export", ARM, "--to", "mjcf"], "--format urdf is the format"),
        (["mastering", ARM], "--format joint-offsets"),
        (["uncertainty", ARM], "calib study ROBOT"),
        (["view", ARM, "-o", "page.html"], "--html FILE"),
        (["view", ARM, READ], "calib view ROBOT --data FILE"),
        (["verify", ARM, "--validate", READ], "calib verify ROBOT DATA"),
        (["watch", ARM, READ, "--target", "0.1mm"], "--goal 0.1mm"),
        (["board", "--size", "8x6"], "--board charuco"),
        (["completion", "bash"], "_CALIB_COMPLETE=bash_source"),
    ],
)
def test_the_command_line_names_the_way(typed, words, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["calib", *typed])
    with pytest.raises(SystemExit) as ended:
        main()
    told = capsys.readouterr().err
    assert ended.value.code == 2
    assert words in told
    assert len(told.splitlines()) == 1


def test_options_that_the_table_names_are_options_of_the_command():
    context = click.Context(group)
    commands = {name: group.get_command(context, name) for name in group.list_commands(context)}
    for place, rows in tables().items():
        here = place.removeprefix("calib ") if place.startswith("calib ") else ""
        for row in rows:
            for code in re.findall(r"`([^`]*)`", row.here):
                name = code.split()[1] if code.startswith("calib ") and len(code.split()) > 1 else here
                if name in commands:
                    known = {option for parameter in commands[name].params for option in parameter.opts}
                    assert {*re.findall(r"--[a-z-]+", code)} <= known | {"--help"}, row.here


def test_a_command_without_out_prints_and_writes_nothing(run_calib, tmp_path):
    run = run_calib("fit", ARM, READ, cwd=tmp_path)
    assert run.code == 0
    assert "Verdict: PASS" in run.out
    assert "Nothing is written: --out DIR" in run.out
    assert not list(tmp_path.iterdir())


@pytest.mark.quick(0)
def test_parameters_are_fixed_freed_and_given_priors_by_name_on_the_command_line(run_calib, tmp_path):
    typed = ("--fix", "all", "--free", "joint_3.z, joint_4.x", "--prior", "joint_4.x=0.1um", "--json")
    run = run_calib("fit", ARM, READ, *typed, cwd=tmp_path)
    told = {parameter["name"]: parameter for parameter in json.loads(run.out)["parameters"]}
    assert told["joint_3.x"]["status"] == "held"
    assert told["joint_3.z"]["std"] > 0
    assert told["joint_4.x"]["value"] == pytest.approx(told["joint_4.x"]["nominal"], abs=1e-3)  # mm
    assert "is not a name and a value" in run_calib("fit", ARM, READ, "--prior", "joint_3.z=0.1", cwd=tmp_path).err


def test_short_letters_are_those_of_other_programs(run_calib, tmp_path):
    assert run_calib("sample", ARM, "-n", "3", "-o", "poses.csv", "-q", cwd=tmp_path).out == ""
    assert run_calib("sample", ARM, "-n", "4", "-o", "poses.csv", "-f", cwd=tmp_path).code == 0
    assert len(calib.read_poses(tmp_path / "poses.csv", ARM)) == 4
    shutil.copy(EXAMPLES / "arm.urdf", tmp_path)
    assert run_calib("init", "arm.urdf", cwd=tmp_path).code == 0
    assert (tmp_path / "arm.yaml").exists()


def test_the_page_is_made_of_the_table(monkeypatch):
    monkeypatch.syspath_prepend(str(EXAMPLES.parent / "site"))
    make_words_page = importlib.import_module("make_words_page")
    assert make_words_page.PAGE.read_text(encoding="utf-8") == make_words_page.page()


@pytest.mark.quick(0)
def test_what_is_printed_says_what_it_is_what_is_inside_and_what_is_next(t):
    for held in (
        calib.check(t.robot, t.q),
        calib.select(t.robot, t.robot.sample(30, seed=1), count=10),
        t.fit.predict(t.q),
        calib.predict(t.robot, t.q),
        calib.verify(t.fit, t.data),
        calib.solve(t.fit, t.fit.robot.positions(t.q)[:, 0]),
        calib.solve(t.fit, [[9.0, 0.0, 0.0]]),
    ):
        headline, *_, inside, following = str(held).split("\n")
        assert re.search(r"\d", headline)
        assert hasattr(held, re.match(r"Inside: (\w+)", inside)[1])
        assert following.startswith("Next: ")


def test_hints_name_frames_and_parameters_that_the_robot_has(t):
    for robot in (t.robot, calib.load(str(EXAMPLES / "five_bar.yaml"))):
        for word in ("fk", "jacob0", "params", "hold", "prior"):
            with pytest.raises(calib.InputError) as caught:
                getattr(robot, word)
            named = re.findall(r'\("([^"]+)"|\["([^"]+)"', str(caught.value))
            known = {*robot.frame_names, *(parameter.name for parameter in robot.parameters)}
            assert {first or second for first, second in named} <= known
