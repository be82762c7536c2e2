"""The first guess of someone who knows numpy, lmfit or scikit-learn is right."""

from pathlib import Path

import numpy as np
import pytest

import calib
from calib.identification.estimates import table_html

EXAMPLES = Path(__file__).parents[1] / "docs" / "examples"


@pytest.fixture(scope="module")
def robot():
    return calib.load(EXAMPLES / "arm.yaml")


@pytest.fixture(scope="module")
def data(robot):
    return calib.read_measurements(EXAMPLES / "arm_simulated.csv", robot)


@pytest.fixture(scope="module")
def fit(robot, data):
    used, held = data.split(0.25, seed=1)
    return calib.fit(robot, used, validation=held)


def test_measurements_are_taken_like_rows_of_an_array(data):
    assert len(data[:60]) == 60
    assert len(data[data.joints[:, 0] > 0]) == int(np.sum(data.joints[:, 0] > 0))
    np.testing.assert_array_equal(data[[3, 1]].joints, data.joints[[3, 1]])
    np.testing.assert_array_equal(data[-1].joints, data.joints[-1:])
    with pytest.raises(calib.DataError, match="it has 80 rows"):
        data[80]
    with pytest.raises(calib.DataError, match="it has 80 rows"):
        data[np.array([True, False])]


def test_parts_of_the_measurements_are_held_out(data):
    used, held = data.split(0.25, seed=1)
    assert (len(used), len(held)) == (60, 20)
    assert sorted(used.names + held.names) == sorted(data.names)


def test_what_is_printed_is_short_and_says_what_it_is(robot, data, fit):
    for one in (robot, data, fit, fit.parameters, fit.covariance):
        assert len(repr(one)) < 200
        assert "array(" not in repr(one)
    assert "PASS" in repr(fit)
    assert str(fit) == fit.report()


def test_parameters_are_found_by_name_and_go_back_into_a_robot(robot, fit):
    one = fit.parameters["joint_3.z"]
    place = [p.name for p in robot.parameters].index("joint_3.z")
    assert one.value == fit.robot.values[place]
    assert one.nominal == robot.values[place]
    assert one.interval == pytest.approx((one.value - one.std * 2.0, one.value + one.std * 2.0), abs=0.1 * one.std)
    assert (one.unit, one.status) == ("mm", "identified")
    again = robot.with_parameters({name: estimate.value for name, estimate in fit.parameters.items()})
    np.testing.assert_array_equal(again.values, fit.robot.values)
    with pytest.raises(calib.InputError, match=r"no parameter 'joint_3\.zz'; did you mean 'joint_3\.z'"):
        fit.parameters["joint_3.zz"]


def test_the_covariance_is_named(fit):
    assert fit.covariance["joint_3.z", "joint_3.z"] == pytest.approx(fit.parameters["joint_3.z"].std ** 2)
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
    held = robot.hold("joint_3.z", "joint_4.x")
    assert [p.name for p, free in zip(held.parameters, held.is_free, strict=True) if not free] == [
        "joint_3.z",
        "joint_4.x",
    ]
    assert calib.fit(held, data).parameters["joint_3.z"].status == "held"
    assert np.all(held.free("joint_3.z", "joint_4.x").is_free)
    assert np.all(robot.is_free)
    with pytest.raises(calib.ParameterError, match="did you mean"):
        robot.hold("joint_3.zz")


def test_notebooks_show_tables_in_which_names_are_no_markup(fit):
    page = fit._repr_html_()
    assert page.count("<table>") == 2
    assert "array(" not in page
    assert "&lt;b&gt;" in table_html([{"name": "<b>"}])


def test_a_table_is_a_data_frame_where_pandas_is_installed(fit):
    pandas = pytest.importorskip("pandas")
    table = fit.parameters.to_dataframe()
    assert isinstance(table, pandas.DataFrame)
    assert table.loc["joint_3.z", "value"] == pytest.approx(1e3 * fit.parameters["joint_3.z"].value)
    assert fit.covariance.to_dataframe().loc["joint_3.z", "joint_3.z"] == fit.covariance["joint_3.z", "joint_3.z"]
