"""The first guess of someone who knows numpy, lmfit or scikit-learn is right."""

import itertools
from importlib.metadata import version
from inspect import Parameter, signature
from xml.etree import ElementTree

import numpy as np
import pytest

import calib
from calib import pictures
from calib.core.base.words import table_html
from tests.project import EXAMPLES
from tests.whole.conftest import READ


def test_measurements_are_taken_like_rows_of_an_array(data):
    assert len(data[:60]) == 60
    assert len(data[data.joints[:, 0] > 0]) == int(np.sum(data.joints[:, 0] > 0))
    np.testing.assert_array_equal(data[[3, 1]].joints, data.joints[[3, 1]])
    np.testing.assert_array_equal(data[-1].joints, data.joints[-1:])
    with pytest.raises(calib.DataError, match="it has 80 rows"):
        data[80]
    with pytest.raises(calib.DataError, match="it has 80 rows"):
        data[np.array([True, False])]


def test_what_is_printed_is_short_and_says_what_it_is(robot, data, fit):
    q = robot.sample(30, seed=3)
    chosen, reached = calib.select(robot, q, count=20), calib.solve(fit.robot, fit.robot.positions(q[:4])[:, 0])
    compared = calib.compare(fit, calib.fit(robot, data))
    assert "fit 2" in str(compared)
    made = calib.check(robot, q), chosen, reached, compared, fit.validation, fit.predict(q)
    for item in (robot, data, fit, fit.parameters, fit.covariance, *made):
        assert len(repr(item)) < 200
        assert "array(" not in repr(item)
    assert "PASS" in repr(fit)
    assert str(fit) == fit.report()


def test_parameters_are_found_by_name_and_go_back_into_a_robot(robot, fit):
    first = fit.parameters["joint_3.z"]
    place = [p.name for p in robot.parameters].index("joint_3.z")
    assert first.value_si == fit.robot.values[place]
    assert first.nominal_si == robot.values[place]
    assert first.interval == pytest.approx(
        (first.value - first.std * 2.0, first.value + first.std * 2.0), abs=0.1 * first.std
    )
    assert (first.unit, first.status) == ("mm", "identified")
    again = robot.with_parameters({name: estimate.value_si for name, estimate in fit.parameters.items()})
    np.testing.assert_array_equal(again.values, fit.robot.values)
    with pytest.raises(calib.InputError, match=r"no parameter 'joint_3\.zz'; did you mean 'joint_3\.z'"):
        fit.parameters["joint_3.zz"]


def test_a_number_and_the_unit_beside_it_belong_together(robot, fit, tmp_path):
    fit.save(tmp_path / "out", pages=False)
    loaded = calib.load_result(tmp_path / "out").parameters
    rows = {row["name"]: row for row in fit.parameters.rows()}
    for name, scale, unit in (("joint_3.z", 1e3, "mm"), ("joint_3.rx", 180 / np.pi, "deg")):
        before = robot.parameters[name]
        assert (before.unit, before.nominal, before.sigma) == (
            unit,
            pytest.approx(scale * before.nominal_si, rel=1e-14),
            pytest.approx(scale * before.sigma_si, rel=1e-14),
        )
        for item in (fit.parameters[name], loaded[name]):
            assert item.unit == unit
            for key in ("nominal", "value", "std", "low95", "high95"):
                number = getattr(item, key)
                assert number == pytest.approx(scale * getattr(item, f"{key}_si"), rel=1e-14)
                assert number == pytest.approx(rows[name][key], rel=1e-9)
    assert 430 < fit.parameters["joint_3.z"].value < 450  # a link of 440 mm
    assert 0.43 < fit.parameters["joint_3.z"].value_si < 0.45
    assert " mm " in str(fit.parameters["joint_3.z"])


@pytest.mark.quick(0)
def test_a_saved_result_says_what_the_fit_said(robot, fit, tmp_path):
    held = calib.read_measurements(EXAMPLES / "arm_simulated.csv", robot)[60:]
    short = calib.fit(robot, held, sigma="0.001 mm", folds=4)  # noise stated far too small: CHECK
    for k, saved in enumerate((fit, short)):
        saved.save(tmp_path / f"{k}", pages=False, force=True)
        loaded = calib.load_result(tmp_path / f"{k}")
        assert loaded.verdict.grade == saved.verdict.grade
        assert [(reason.code, reason.text) for reason in loaded.verdict.reasons] == [
            (reason.code, reason.text) for reason in saved.verdict.reasons
        ]
        assert loaded.verdict.claim.words == saved.verdict.claim.words
        assert loaded.verdict.claim.holds == saved.verdict.claim.holds
        assert loaded.verdict.not_covered == saved.verdict.not_covered
        assert loaded.rms == pytest.approx(saved.rms, rel=1e-9)
        assert loaded.sigma == pytest.approx(saved.sigma, rel=1e-9)
        assert loaded.converged == saved.converged
        assert loaded.verdict.claim.words in loaded.summary()
    fit.export(tmp_path / "fit.urdf")
    calib.load_result(tmp_path / "0").export(tmp_path / "loaded.urdf")
    assert urdf_poses(tmp_path / "loaded.urdf") == pytest.approx(urdf_poses(tmp_path / "fit.urdf"), rel=1e-12)


def urdf_poses(path):
    origins = ElementTree.parse(path).getroot().iter("origin")
    return [float(number) for origin in origins for key in ("xyz", "rpy") for number in origin.get(key, "").split()]


def test_the_covariance_is_named(fit):
    assert fit.covariance["joint_3.z", "joint_3.z"] == pytest.approx(fit.parameters["joint_3.z"].std_si ** 2)
    assert np.asarray(fit.covariance).shape == (len(fit.free_names),) * 2
    with pytest.raises(calib.InputError, match="no free parameter 'nobody'"):
        fit.covariance["nobody", "joint_3.z"]


def test_residuals_and_predictions_come_from_the_fit(fit):
    (residuals,) = fit.residuals.values()
    table = fit.identification.table()["after"]
    assert 1e3 * np.sqrt(np.mean(np.sum(residuals**2, axis=1))) == pytest.approx(table["rms"])
    q = fit.validation.data.joints
    np.testing.assert_array_equal(fit.predict(q).positions, fit.robot.positions(q))
    assert np.all(fit.predict(q).std > 0)


def test_parameters_are_held_and_freed_without_a_file(robot, data):
    held = robot.fix("joint_3.z", "joint_4.x")
    assert [p.name for p, free in zip(held.parameters, held.is_free, strict=True) if not free] == [
        "joint_3.z",
        "joint_4.x",
    ]
    assert calib.fit(held, data).parameters["joint_3.z"].status == "held"
    assert np.all(held.free("joint_3.z", "joint_4.x").is_free)
    assert np.all(robot.is_free)
    with pytest.raises(calib.ParameterError, match="did you mean"):
        robot.fix("joint_3.zz")


def test_notebooks_show_tables_in_which_names_are_no_markup(fit):
    page = fit._repr_html_()
    assert page.count("<table>") == 2
    assert "array(" not in page
    assert "&lt;b&gt;" in table_html([{"name": "<b>"}])


def test_a_table_is_a_data_frame_where_pandas_is_installed(robot, data, fit, tmp_path):
    pandas = pytest.importorskip("pandas")
    table = fit.parameters.to_dataframe()
    assert isinstance(table, pandas.DataFrame)
    assert table.loc["joint_3.z", "value"] == pytest.approx(fit.parameters["joint_3.z"].value)
    read = data.to_dataframe(robot)
    assert list(read.dtypes.unique()) == [read["pose"].dtype, np.dtype(float)]
    np.testing.assert_allclose(read["reflector_x [mm]"], 1e3 * data.readings["reflector"].values[:, 0])
    read.to_csv(tmp_path / "data.csv", index=False)
    np.testing.assert_allclose(calib.read_measurements(tmp_path / "data.csv", robot).joints, data.joints)
    assert fit.covariance.to_dataframe().loc["joint_3.z", "joint_3.z"] == fit.covariance["joint_3.z", "joint_3.z"]


def test_a_robot_needs_no_file(robot):
    made = calib.robot(
        EXAMPLES / "arm.urdf",
        motors=[f"joint_{k}" for k in range(1, 7)],
        target={"reflector": {"frame": "flange", "xyz": ["20 mm", 0, "50 mm"], "position": "unknown", "sigma": "5 mm"}},
        base="base_link",
        parametrisation=[
            {"origin": "all", "components": ["x", "y", "z"], "sigma": "1 mm"},
            {"origin": "all", "components": ["rx", "ry", "rz"], "sigma": 3e-3},
        ],
        sigma="0.03 mm",
    )
    assert made.parameters == robot.parameters
    plain = calib.robot(EXAMPLES / "arm.urdf")
    assert plain.parameters == calib.load(EXAMPLES / "arm.urdf").parameters
    assert calib.robot(EXAMPLES / "arm.urdf", target="link_5").target_names == ("link_5",)


def test_a_robot_with_loops_needs_no_file():
    written = calib.load(EXAMPLES / "five_bar.yaml")
    made = calib.robot(
        EXAMPLES / "five_bar.urdf",
        motors=["left_motor", "right_motor"],
        target={"pen": {"frame": "left_tip", "xyz": [0, 0, "20 mm"]}},
        base="table",
        closed_loop=[["left_tip", "right_tip"]],
        type=["3d"],
        closed_loop_axes=[["x", "y"]],
        home={"left_motor": "126 deg", "right_motor": "54 deg", "left_elbow": "-82.5 deg", "right_elbow": "82.5 deg"},
    )
    q = calib.sample(written, 10, seed=1).joints
    np.testing.assert_allclose(made.positions(q), written.positions(q), atol=1e-12)  # closed to 1e-12 m


def test_priors_are_stated_without_a_file(robot, data):
    tight = robot.with_prior(["joint_2.y", "joint_3.y"], "1 um").with_prior("joint_4.rx", "1 urad")
    sigma = {p.name: p.sigma_si for p in tight.parameters}
    assert (sigma["joint_2.y"], sigma["joint_3.y"], sigma["joint_4.rx"]) == (1e-6, 1e-6, 1e-6)
    assert {name: s for name, s in sigma.items() if name not in ("joint_2.y", "joint_3.y", "joint_4.rx")} == {
        p.name: p.sigma_si for p in robot.parameters if p.name not in ("joint_2.y", "joint_3.y", "joint_4.rx")
    }
    assert {p.name: p.sigma_si for p in tight.with_prior("joint_2.y", "2 mm").parameters}["joint_2.y"] == 2e-3
    assert calib.fit(tight, data).parameters["joint_2.y"].std_si < 1.001e-6
    moved = robot.with_parameters({"joint_2.y": 1e-3}).with_prior("joint_3.y", "0.1 mm")
    assert {p.name: v for p, v in zip(moved.parameters, moved.values, strict=True)}["joint_2.y"] == 1e-3


def test_a_list_says_what_text_with_commas_says(robot, data):
    text = calib.fit(robot, data, terms="backlash,joint_2=gain")
    listed = calib.fit(robot, data, terms=["backlash", "joint_2=gain"])
    assert [p.name for p in listed.robot.parameters] == [p.name for p in text.robot.parameters]
    assert len(listed.robot.terms) == 7
    np.testing.assert_array_equal(listed.robot.values, text.robot.values)
    held = robot.fix(["joint_3.z", "joint_4.x"])
    np.testing.assert_array_equal(held.is_free, robot.fix("joint_3.z", "joint_4.x").is_free)
    assert np.all(held.free(("joint_3.z", "joint_4.x")).is_free)


@pytest.mark.quick(1)
@pytest.mark.parametrize(
    ("given", "steps"),
    [({}, 3), ({"starts": 3}, 5), ({"folds": 2}, 5), ({"terms": "auto"}, 7), ({"exclude_outliers": True}, 6)],
)
def test_progress_is_told_step_by_step_to_the_end(robot, data, given, steps):
    told = []
    calib.fit(robot, data, **given, progress=lambda done, total: told.append((done, total)))
    assert [done for done, _ in told] == list(range(1, steps + 1))
    assert told[-1] == (steps, steps)
    assert all(before <= after for (_, before), (_, after) in itertools.pairwise(told))  # what is known by then


def test_the_package_says_its_version():
    assert calib.__version__ == version("medrue")


def test_a_robot_made_in_python_is_saved_and_loads_the_same(robot, tmp_path):
    made = robot.fix("joint_3.z").with_prior("joint_2.y", "10 um").with_prior("joint_4.rx", "10 urad")
    made.save(tmp_path / "robot.yaml")
    again = calib.load(tmp_path / "robot.yaml")
    assert again.parameters == made.parameters
    np.testing.assert_array_equal(again.is_free, made.is_free)
    q = calib.sample(robot, 5, seed=1).joints
    np.testing.assert_array_equal(again.positions(q), made.positions(q))
    made.save(tmp_path / "robot.yaml")
    plain = calib.robot(EXAMPLES / "arm.urdf", target="link_5")
    plain.save(tmp_path / "plain.yaml")
    assert calib.load(tmp_path / "plain.yaml").parameters == plain.parameters


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda robot: calib.robot("nowhere.urdf"), "nowhere.urdf"),
        (lambda robot: calib.robot(EXAMPLES / "arm.urdf", motors=["joint_9"]), "joint_9"),
        (lambda robot: calib.robot(EXAMPLES / "arm.urdf", motors="joint_1"), "should be a list"),
        (lambda robot: calib.robot(EXAMPLES / "arm.urdf", base="floor"), "floor"),
        (lambda robot: calib.robot(EXAMPLES / "arm.urdf", target="hand"), "hand"),
        (lambda robot: calib.robot(EXAMPLES / "arm.urdf", sigmas="1 mm"), "unknown key 'sigmas'; did you mean 'sigma'"),
        (lambda robot: robot.with_prior("joint_3.zz", "1 mm"), "did you mean"),
        (lambda robot: robot.with_prior("joint_3.z", "1 deg"), "unit 'deg' is for an angle"),
        (lambda robot: robot.with_prior("joint_3.z", "0 mm"), "must be positive"),
        (lambda robot: robot.with_parameters({"joint_3.z": 0.5}).save("robot.yaml"), "'joint_3.z' is not nominal"),
        (lambda robot: robot.save("robot.txt"), "ends in .yaml"),
        (
            lambda robot: calib.fit(robot.fix([p.name for p in robot.parameters]), READ),
            "every parameter is held",
        ),
        (lambda robot: calib.fit(robot, READ, terms=["slack"]), "no term 'slack'"),
        (lambda robot: calib.fit(robot, READ, terms=[]), "the list is empty"),
        (lambda robot: calib.fit(robot, READ, terms=[1]), "a list of texts"),
        (lambda robot: robot.positions(calib.sample(robot, 5)), "Poses are not an array; give .joints"),
        (lambda robot: robot.parameters["joint_3.zz"], "did you mean 'joint_3.z'"),
        (lambda robot: calib.simulate(robot, np.zeros((1, 6)), 0.0, seed=-1), "seed -1"),
    ],
)
def test_a_wrong_guess_is_told_in_one_line(robot, tmp_path, monkeypatch, wrong, words):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(calib.InputError) as caught:
        wrong(robot)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_whatever_is_random_takes_a_seed_and_no_count_is_that_of_some_robot():
    for function in (calib.fit, calib.select, calib.simulate, calib.sample, calib.Watch, calib.Measurements.split):
        assert "seed" in signature(function).parameters, function.__name__
    for function in (calib.select, calib.sample):
        assert signature(function).parameters["count"].default is Parameter.empty


def test_what_draws_and_what_it_needs_is_said_where_it_is_missing(fit, monkeypatch):
    monkeypatch.setattr(pictures, "entry_points", lambda **_: ())
    with pytest.raises(calib.InputError, match="nothing that draws is installed"):
        _ = fit.plot


def test_wrong_words_for_a_figure_are_told(fit):
    with pytest.raises(calib.InputError, match="did you mean 'joint_2'"):
        fit.plot.residuals("joint2")
    with pytest.raises(calib.InputError, match="expected matplotlib axes, not int"):
        fit.plot.errors(3)


def test_a_figure_of_its_own_is_made_where_no_axes_are_given(fit):
    pyplot = pytest.importorskip("matplotlib.pyplot")
    pyplot.switch_backend("agg")
    axes = fit.plot.errors()
    assert axes.get_xlabel().endswith("[mm]")
    pyplot.close(axes.figure)


@pytest.mark.parametrize("call", ["check", "export", "fit", "sample", "select", "simulate", "study"])
def test_a_fit_in_place_of_a_robot_is_answered_with_what_to_give(data, fit, call):
    arguments = {"export": ("urdf", "calibrated.urdf"), "sample": (5,), "fit": (data,)}.get(call, (data.joints,))
    options = {"count": 3} if call == "select" else {}
    with pytest.raises(calib.CalibrationError, match="expected a Robot, not Calibration; load one with calib"):
        getattr(calib, call)(fit, *arguments, **options)


def test_joint_values_in_place_of_goals_are_answered_with_what_to_give(robot, data):
    with pytest.raises(calib.CalibrationError, match="goals: are joint values; give positions"):
        calib.solve(robot, data)
