"""Parameter files: values are read to the last digit, and every mistake is named with its line and parameter."""

import numpy as np
import pytest

from calib.core.base.errors import DataError, ParameterError
from calib.core.data.parameter_files import read_parameters


def parameter_file(robot):
    """Values of a robot in the units of its parameters, to all digits."""
    rows = zip(robot.parameters, robot.values.tolist(), strict=True)
    return "\n".join(["parameter,value,unit", *(f"{p.name},{value * p.per_si!r},{p.unit}" for p, value in rows)]) + "\n"


@pytest.fixture
def read(tmp_path, arm):
    """Write a parameter file and read it for a robot."""

    def read_text(text, robot=arm):
        path = tmp_path / "parameters.csv"
        path.write_text(text)
        return read_parameters(path, robot)

    return read_text


def test_values_are_converted_from_their_units(read):
    values = read(
        "parameter,value,unit\nturn.x,178,mm\nturn.rz,180,deg\nslide.y,0.25,\nwrist.rx,-2,mrad\nwrist.z,3,um\n"
    )
    assert values == {"turn.x": 0.178, "turn.rz": np.pi, "slide.y": 0.25, "wrist.rx": -0.002, "wrist.z": 3e-6}
    assert read("unit,note,value,parameter\n mm ,a,1, turn.x \n") == {"turn.x": 0.001}


def test_a_file_may_be_asked_to_be_complete(tmp_path, arm):
    path = tmp_path / "parameters.csv"
    lines = parameter_file(arm).splitlines()
    path.write_text("\n".join(lines))
    assert len(read_parameters(path, arm, complete=True)) == 24
    path.write_text("\n".join(lines[:-1]))
    assert len(read_parameters(path, arm)) == 23
    with pytest.raises(ParameterError, match=r"no value for parameter 'flange\.rz'; the file is not complete"):
        read_parameters(path, arm, complete=True)


def test_values_in_their_units_are_read_to_the_last_digit(read, medrue):
    generator = np.random.default_rng(1)
    values = medrue.values + generator.normal(0, 0.3, len(medrue.values))
    text = parameter_file(medrue.with_parameters(values))
    result = medrue.with_parameters(read(text, medrue)).values
    assert np.abs(result / values - 1).max() < 4e-16  # one rounding to mm or deg, one back
    assert text.startswith("parameter,value,unit\nA1y,")
    assert medrue.with_parameters(read(parameter_file(medrue), medrue)).calibrated_urdf() == medrue.urdf.source


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("turn.rx,1,dge\n", "line 2, parameter 'turn.rx': unknown unit 'dge'; did you mean 'deg'?"),
        ("turn.x,1,mm\nturnx,1,mm\n", "line 3: no parameter 'turnx'; did you mean 'turn.x'?"),
        ("turn.x,1,mm\n turn.x,1,mm\n", "line 3: parameter 'turn.x' is given twice"),
        ("turn.x,one,mm\n", "line 2, parameter 'turn.x': 'one' is not a number"),
        ("turn.x,178,\n", "line 2, parameter 'turn.x': 178 m is not plausible; write the unit"),
    ],
)  # fmt: skip
def test_a_mistake_is_named_with_its_place(read, tmp_path, rows, message):
    with pytest.raises((DataError, ParameterError)) as caught:
        read("parameter,value,unit\n" + rows)
    assert str(caught.value).removeprefix(str(tmp_path / "parameters.csv")).lstrip(":, ").startswith(message)


@pytest.mark.parametrize(("header", "missing"), [("parameter,value", "unit"), ("name,value,unit", "parameter")])
def test_a_missing_column_says_what_a_parameter_file_has(read, header, missing):
    with pytest.raises(DataError) as caught:
        read(header + "\n" + ",".join("1" * len(header.split(","))) + "\n")
    assert f"no column '{missing}'" in str(caught.value)
    assert str(caught.value).endswith("a parameter file has the columns parameter, value, unit")
