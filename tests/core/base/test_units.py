"""Units: every one of the contract's converts, and whatever else is given is an error that says what would be right."""

import math

import pytest

from calib.core.base.errors import InputError
from calib.core.base.units import (
    DISPLAY_UNIT,
    ERROR_UNIT,
    from_unit,
    in_unit,
    quantity,
    quantity_text,
    split_column,
)


@pytest.mark.parametrize(
    ("text", "dimension", "expected"),
    [
        ("178 mm", "length", 0.178),  # exactly the float nearest to 0.178: the reason why the table holds units per SI
        ("40um", "length", 40e-6),
        ("40 \N{MICRO SIGN}m", "length", 40e-6),
        ("40 \N{GREEK SMALL LETTER MU}m", "length", 40e-6),
        ("180 °", "angle", math.pi),
        ("-1.5e-3 m", "length", -1.5e-3),
        ("0.25", "length", 0.25),
        (3, "length", 3.0),
        ("180 deg", "angle", math.pi),
        ("+90. deg", "angle", math.pi / 2),
        (".5 mrad", "angle", 0.5e-3),
        ("1 rad", "angle", 1.0),
    ],
)
def test_a_quantity_is_read_exactly_in_si(text, dimension, expected):
    assert quantity(text, dimension, "here") == expected


@pytest.mark.parametrize(
    ("value", "unit", "expected"),
    [
        (0.178, "mm", 178.0),
        (math.pi / 180, "arcsec", 3600.0),
        (7200.0, DISPLAY_UNIT["time"], 7200.0),
        (0.25, ERROR_UNIT["angle"], 250.0),
    ],
)
def test_a_value_is_shown_in_the_unit_that_is_named(value, unit, expected):
    assert in_unit(value, unit) == pytest.approx(expected, rel=1e-15)
    assert from_unit(expected, unit) == pytest.approx(value, rel=1e-15)
    assert quantity_text(value, unit, ".6g") == f"{expected:.6g} {unit}"


IMPLAUSIBLE = "is not plausible; write the unit after the number, such as"


@pytest.mark.parametrize(
    ("value", "dimension", "message"),
    [
        ("1 deg", "length", "here: unit 'deg' is for an angle; a length is expected (m, mm, um)"),
        ("1 mm", "angle", "here: unit 'mm' is for a length; an angle is expected (rad, deg, mrad, urad, arcsec)"),
        ("1 inch", "length", "here: unknown unit 'inch'; valid: m, mm, um"),
        ("1 degs", "angle", "here: unknown unit 'degs'; did you mean 'deg'?"),
        (90, "angle", f"here: 90 rad {IMPLAUSIBLE} '90 deg': deg, or rad if it is right"),
        ("-412.7", "length", f"here: -412.7 m {IMPLAUSIBLE} '-412.7 mm': mm, or m if it is right"),
    ],
)
def test_a_wrong_unit_is_an_error_with_the_valid_ones(value, dimension, message):
    with pytest.raises(InputError) as caught:
        quantity(value, dimension, "here")
    assert str(caught.value) == message


@pytest.mark.parametrize(
    "value",
    ["", "mm", "1,5 mm", "1 2 mm", "nan", "inf mm", "1e999 mm", float("nan"), math.inf, 10**400, True, None, []],
)
def test_what_is_no_finite_number_is_an_error(value):
    with pytest.raises(InputError, match=r"here: .* is not a finite number with a unit, such as '0.04 mm'"):
        quantity(value, "length", "here")


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        ("q1", ("q1", None)),
        (" tool_x  [ mm ] ", ("tool_x", "mm")),
        ("q2[deg]", ("q2", "deg")),
        ("q2 []", ("q2", "")),
        ("joint[1] [rad]", ("joint[1]", "rad")),
        ("q[0]", ("q[0]", None)),
        ("X / mm", ("X", "mm")),
        ("J1/°", ("J1", "°")),
        ("speed m/s", ("speed m/s", None)),
        ("/arm/mm", ("/arm/mm", None)),
        ("q2 [deg", ("q2 [deg", None)),
        ("", ("", None)),
    ],
)
def test_a_header_is_a_name_and_perhaps_a_unit(header, expected):
    assert split_column(header) == expected


@pytest.mark.parametrize("text", ["1e300 m", "-1e250 mm", "1e-200 mm", 1e12])
def test_a_number_whose_square_no_computation_survives_is_refused(text):
    with pytest.raises(InputError, match=r"here: .* is too (large|small) to mean anything"):
        quantity(text, "length", "here")
