"""`calib certificate`: a budget that refits and Monte Carlo confirm, and XML as the schema has it."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from lxml import etree

import calib
from calib.core.data.in_memory import as_measurements
from calib.core.judging.repeatability import doubtful_repeats
from calib.core.numerics.rigid import best_transform
from calib.quality.certificate_command import signer, verify
from calib.quality.monte_carlo import monte_carlo
from calib.quality.traceability import TraceabilitySection
from calib.quality.uncertainty_budget import (
    CENTRING,
    ELSEWHERE,
    FOCAL_LENGTH,
    MODEL,
    NOISE,
    OFFSET,
    OFFSET_ANGLE,
    PRINCIPAL_POINT,
    PRIOR,
    REPEATABILITY,
    SCALE,
    SIZES,
    TEMPERATURE,
    Budget,
    BudgetRow,
    ErrorPropagation,
    budget,
)
from tests.project import EXAMPLES, copied

STATED = {
    "date": "2026-11-28",
    "laboratory": "Example <laboratory> & sons",
    "item": {"maker": "Example", "serial": 17},
    "instrument": {"type": "tracker", "certificate": "C-1", "scale": "10 um/m", "offset": "15 um"},
    "target": {"centring": "3 um"},
    "temperature": {"calibration": "20 degC", "use": 22, "uncertainty": "1 K", "expansion": "12 um/m/K"},
}
TRACEABILITY = TraceabilitySection.model_validate(STATED)
NAMESPACES = {"dcc": "https://ptb.de/dcc", "si": "https://ptb.de/si"}


def contributions(known):
    return {row.quantity: row.contribution for row in known.rows}


KNOWN = ("pose: unknown", "pose: known")


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """The example arm with a known base."""
    return calib.load(copied(tmp_path_factory.mktemp("arm"), EXAMPLES / "arm.yaml", KNOWN))


@pytest.fixture(scope="module")
def measured(arm):
    """Joint values (82, 6) and simulated readings (82, 3) of an arm as its description expects it."""
    rng, q = np.random.default_rng(7), calib.read_poses(EXAMPLES / "arm_simulated.csv", arm).joints
    off = np.array([parameter.sigma_si for parameter in arm.parameters]) * rng.standard_normal(len(arm.parameters))
    true = arm.with_parameters(arm.values + off * arm.is_free)
    return q, true.positions(q)[:, 0] + 3e-5 * rng.standard_normal((len(q), 3))


@pytest.fixture(scope="module")
def fit(arm, measured):
    return calib.fit(arm, *measured)


@pytest.fixture(scope="module")
def folder(fit, tmp_path_factory):
    path = tmp_path_factory.mktemp("certificate") / "arm"
    fit.save(path)
    return path


@pytest.fixture(scope="module")
def statement(tmp_path_factory):
    path = tmp_path_factory.mktemp("stated") / "stated.yaml"
    path.write_text(json.dumps({"traceability": STATED}))
    return path


def test_noise_shrinks_with_the_number_of_poses_and_scale_does_not(arm, measured, fit):
    few = calib.fit(arm, *(part[:30] for part in measured))
    many, less = (contributions(budget(ErrorPropagation.from_fit(one), TRACEABILITY)) for one in (fit, few))
    assert less[NOISE] > 1.3 * many[NOISE]
    assert less[SCALE] == pytest.approx(many[SCALE], rel=0.25)


def test_an_unknown_base_takes_up_an_offset_and_not_a_scale(robot, data):
    known = contributions(budget(ErrorPropagation.from_fit(calib.fit(robot, data)), TRACEABILITY))
    assert known[OFFSET] < 1e-9 < known[SCALE]


@pytest.mark.quick(0)
@pytest.mark.amount(100, 300)
def test_monte_carlo_finds_what_is_propagated(robot, data, amount):
    linear = ErrorPropagation.from_fit(calib.fit(robot, data[:18]))
    known = budget(linear, TRACEABILITY)
    drawn = monte_carlo(linear, TRACEABILITY, known, draws=amount)
    assert drawn.draws == amount
    assert drawn.difference < 0.52 / np.sqrt(amount)
    wrong = TraceabilitySection.model_validate(STATED | {"instrument": STATED["instrument"] | {"scale": "300 um/m"}})
    assert monte_carlo(linear, wrong, known, draws=30).difference > 0.1


def test_the_claim_is_all_of_the_budget_but_instrument_and_temperature(fit):
    found = contributions(budget(ErrorPropagation.from_fit(fit), TRACEABILITY))
    own = math.hypot(found[NOISE], found[PRIOR], found[MODEL])
    assert own == pytest.approx(fit.verdict.claim.at_measured_poses.rms / math.sqrt(3), rel=1e-6)
    assert found[TEMPERATURE] > 0


def test_combined_expanded_and_effective_freedom_are_those_of_the_gauge_block_of_the_gum():
    """JCGM 100:2008, H.1.6: 25, 9.7, 2.9, 16.6 nm with 18, 25.6, 50, 2 degrees of freedom give 32 nm and 16.7."""
    sizes, freedoms = (25, 9.7, 2.9, 16.6), (18, 25.6, 50, 2)
    rows = tuple(BudgetRow.direct("", 1e-9 * u, v, "") for u, v in zip(sizes, freedoms, strict=True))
    found = Budget((*rows, replace(rows[0], counts=False)))
    assert found.combined_uncertainty == pytest.approx(32e-9, rel=0.02)
    assert found.freedom == pytest.approx(16.7, abs=0.1)
    assert found.coverage_factor == pytest.approx(2.11, abs=0.01)  # table G.2, 17 degrees of freedom, 95 %


def test_maximum_permissible_errors_are_rectangular_and_centring_is_not_counted_twice(fit):
    instrument = {"scale": "10 ppm", "stated": "maximum permissible error"}
    stated = TraceabilitySection.model_validate({"instrument": instrument, "target": {"centring": "1 mm"}})
    rows = {row.quantity: row for row in budget(ErrorPropagation.from_fit(fit), stated).rows}
    assert rows[SCALE].standard_uncertainty == pytest.approx(1e-5 / math.sqrt(3))
    assert (rows[CENTRING].counts, rows[CENTRING].contribution > 1e-5) == (False, True)


def test_poses_elsewhere_add_what_the_claim_grows_by(fit):
    q = 1.8 * fit.identification.data.joints[:20]
    rows = contributions(budget(ErrorPropagation.from_fit(fit), TRACEABILITY, q))
    expected = math.sqrt(max(fit.claim_at(q).rms ** 2 - fit.verdict.claim.at_measured_poses.rms**2, 0) / 3)
    assert rows[ELSEWHERE] == pytest.approx(expected)
    assert expected > 0


@pytest.mark.quick(0)
def test_the_digital_certificate_has_what_the_schema_wants_and_the_numbers_of_the_json(
    folder, statement, tmp_path, run_calib
):
    for ending in ("xml", "json"):
        options = ("--traceability", statement, "--out", tmp_path / f"c.{ending}", "--draws", 20)
        run = run_calib("certificate", folder, *options)
        assert run.code == 0, run.err
    root = etree.parse(tmp_path / "c.xml").getroot()
    known = json.loads((tmp_path / "c.json").read_text())
    names = {element.tag.partition("}")[2] for element in root.iter() if isinstance(element.tag, str)}
    assert root.get("schemaVersion") == "3.2.0"
    assert not names & {"coverageInterval", "standardUnc"}
    assert _children(root) == ["administrativeData", "measurementResults"]
    for place, sequence in SEQUENCES.items():
        order = sequence.replace("!", "").split()
        for element in root.iterfind(f".//dcc:{place}", NAMESPACES):
            found = [order.index(name) for name in _children(element)]
            assert found == sorted(found), place
            assert {name[:-1] for name in sequence.split() if name[-1] == "!"} <= set(_children(element)), place
    for unit in root.iterfind(".//si:unit", NAMESPACES):
        assert unit.text in (r"\metre", r"\radian", r"\kelvin", r"\one")
    quantities = {_text(each, "dcc:name/dcc:content"): each for each in root.iterfind(".//dcc:quantity", NAMESPACES)}
    for row in known["budget"]["rows"]:
        if row["counts"]:
            assert float(_text(quantities[row["quantity"]], "si:real/si:value")) == row["contribution"]
    for parameter in known["parameters"]:
        quantity, half = quantities[parameter["name"]], known["coverage_factor_of_parameters"] * parameter["std_si"]
        assert float(_text(quantity, "si:real/si:value")) == parameter["value_si"]
        assert float(_text(quantity, "si:real/si:expandedUnc/si:uncertainty")) == pytest.approx(half, rel=1e-12)
    (expanded,) = [each for name, each in quantities.items() if name.startswith("deviation of")]
    told = _text(expanded, "si:real/si:expandedUnc/si:uncertainty")
    assert float(told) == known["budget"]["expanded_uncertainty"]
    assert _text(root, ".//dcc:calibrationLaboratory//dcc:content") == STATED["laboratory"]
    assert "accredited" in _text(root, ".//dcc:statement//dcc:content")


def _children(element):
    return list(dict.fromkeys(child.tag.partition("}")[2] for child in element if isinstance(child.tag, str)))


def _text(element, path):
    return element.findtext(path, namespaces=NAMESPACES)


SEQUENCES = {  # https://ptb.de/dcc/v3.2.0/dcc.xsd: of each type, as far as it is used; !: what it must have
    "software": "name! release! type description",
    "coreData": "countryCodeISO3166_1! usedLangCodeISO639_1! mandatoryLangCodeISO639_1! uniqueIdentifier!"
    " identifications receiptDate beginPerformanceDate! endPerformanceDate! performanceLocation!",
    "item": "name! description manufacturer! model identifications!",
    "identification": "issuer! value! name",
    "contact": "name! eMail location!",
    "customer": "name! eMail location!",
    "measurementResult": "name! usedMethods measuringEquipments influenceConditions results!",
    "measuringEquipment": "name! manufacturer model identifications",
    "influenceCondition": "name! data!",
    "result": "name! data!",
}


@pytest.mark.quick(0)
def test_pages_say_that_software_gives_no_legal_force(folder, statement, tmp_path, run_calib):
    pytest.importorskip("fpdf")
    for ending in ("html", "pdf"):
        out = tmp_path / f"c.{ending}"
        assert run_calib("certificate", folder, "--traceability", statement, "--out", out, "--draws", 5).code == 0
    page = (tmp_path / "c.html").read_text()
    assert "Only an accredited laboratory" in page
    assert "24 um/m: apply this correction" in page  # 12 um/m/K times 2 K
    assert (tmp_path / "c.pdf").read_bytes().startswith(b"%PDF")


def test_a_failed_fit_that_was_forced_is_named(arm, measured, tmp_path, run_calib):
    q, readings = measured
    calib.fit(arm, q[:30] * [1, 1, -1, 1, 1, 1], readings[:30]).save(tmp_path / "forced", force=True, pages=False)
    run = run_calib("certificate", tmp_path / "forced", "--out", tmp_path / "c.json", "--draws", 0)
    assert run.code == 0
    assert f"the fit in {tmp_path / 'forced'} failed; {tmp_path / 'c.json'} states the verdict" in run.err
    assert json.loads((tmp_path / "c.json").read_text())["verdict"] == "FAIL"


def test_repeated_poses_bring_repeatability_and_the_figures_of_iso_9283(arm, measured, tmp_path, run_calib):
    rng, scatter = np.random.default_rng(4), 2e-5
    again, names = np.repeat(np.arange(24), 4), np.repeat([f"p{k}" for k in range(24)], 4)
    q, y = (part[again] for part in measured)
    fit = calib.fit(arm, as_measurements(arm, q, y + scatter * rng.standard_normal(y.shape), list(names)))
    found = {row.quantity: row for row in budget(ErrorPropagation.from_fit(fit), TRACEABILITY).rows}
    assert found[REPEATABILITY].contribution == pytest.approx(scatter, rel=0.15)  # 216 degrees of freedom
    assert found[REPEATABILITY].freedom == 24 * 3 * 3
    fit.save(tmp_path / "fit")
    out = tmp_path / "c.json"
    assert run_calib("certificate", tmp_path / "fit", "--out", out, "--draws", 0).code == 0
    content = json.loads(out.read_text())
    assert {figure["name"] for figure in content["iso9283"]} == {"AP", "RP"}
    assert "if the robot did not leave the pose between two repeats" in content["iso9283_doubt"]  # four rows in a row
    assert any("nothing else if the robot did not move" in str(row) for row in content["budget"]["rows"])
    turned = np.arange(96).reshape(24, 4).T.ravel()
    apart = calib.fit(arm, as_measurements(arm, q[turned], y[turned], [names[k] for k in turned]))
    assert doubtful_repeats(fit.identification)
    assert not doubtful_repeats(apart.identification)


@pytest.mark.parametrize(
    ("stated", "said"),
    [
        ("{instrument: {scale: 10 um}}", "traceability.instrument.scale: '10 um' is not a ratio, such as '10 um/m'"),
        ("{instrument: {scal: 1}}", "unknown key 'traceability.instrument.scal'; did you mean 'scale'?"),
        ("{date: yesterday}", "traceability.date"),
        ("{temperature: {use: warm}}", "traceability.temperature.use: 'warm' is not a temperature"),
        ("[1]", "traceability"),
        ("{laboratory: Example}", "needs the day of the measurements"),
    ],
)
def test_what_is_stated_wrongly_is_one_line(folder, tmp_path, run_calib, stated, said):
    path = tmp_path / "stated.yaml"
    path.write_text(f"traceability: {stated}\n")
    out = tmp_path / "c.xml"
    run = run_calib("certificate", folder, "--traceability", path, "--out", out, "--draws", 0)
    assert said in run.refusal()
    assert not out.exists()


def test_another_ending_is_one_line(folder, tmp_path, run_calib):
    assert "give it an ending" in run_calib("certificate", folder, "--out", tmp_path / "c.docx").refusal()


@pytest.fixture(scope="module")
def keys(tmp_path_factory):
    """Files of a private key, of its public one, and of another public one."""
    serialization = pytest.importorskip("cryptography.hazmat.primitives.serialization")
    ed25519 = pytest.importorskip("cryptography.hazmat.primitives.asymmetric.ed25519")
    folder, pem = tmp_path_factory.mktemp("keys"), serialization.Encoding.PEM
    key, other = ed25519.Ed25519PrivateKey.generate(), ed25519.Ed25519PrivateKey.generate()
    plain = serialization.NoEncryption(), serialization.BestAvailableEncryption(b"secret")
    for name, encryption in zip(("private", "locked"), plain, strict=True):
        text = key.private_bytes(pem, serialization.PrivateFormat.PKCS8, encryption)
        (folder / f"{name}.pem").write_bytes(text)
    for name, public in (("public", key.public_key()), ("other", other.public_key())):
        text = public.public_bytes(pem, serialization.PublicFormat.SubjectPublicKeyInfo)
        (folder / f"{name}.pem").write_bytes(text)
    return folder


def test_a_changed_byte_of_a_signed_certificate_is_found(folder, statement, keys, tmp_path, run_calib):
    out, public = tmp_path / "c.xml", keys / "public.pem"
    options = ("--traceability", statement, "--draws", 0, "--sign", keys / "private.pem")
    assert run_calib("certificate", folder, "--out", out, *options).code == 0
    run = run_calib("certificate", out, "--verify", public)
    assert (run.code, "signed it" in run.out) == (0, True)
    content, rng = out.read_bytes(), np.random.default_rng(1)
    for place in rng.integers(0, len(content), 100):
        out.write_bytes(content[:place] + bytes([content[place] ^ int(rng.integers(1, 256))]) + content[place + 1 :])
        with pytest.raises(calib.ComputationError, match="was changed, or another key signed"):
            verify(str(out), str(public))
    assert run_calib("certificate", out, "--verify", public).code == 3
    out.write_bytes(content)
    assert run_calib("certificate", out, "--verify", keys / "other.pem").code == 3


def test_keys_that_are_none_are_one_line_and_nothing_is_written(folder, keys, tmp_path, run_calib):
    out = tmp_path / "c.json"
    for key in (keys / "public.pem", folder / "result.json"):
        run = run_calib("certificate", folder, "--out", out, "--draws", 0, "--sign", key)
        assert "is no private Ed25519 key (PEM)" in run.refusal()
    assert not out.exists()
    assert signer(str(keys / "locked.pem"), lambda: "secret")(b"x") == signer(str(keys / "private.pem"), str)(b"x")
    with pytest.raises(calib.InputError, match="or has another password"):
        signer(str(keys / "locked.pem"), lambda: "wrong")
    (tmp_path / "c.json.sig").write_text("")
    out.write_text("{}")
    with pytest.raises(calib.InputError, match="is no public Ed25519 key"):
        verify(str(out), str(keys / "private.pem"))


CAMERA = (
    "{kind: pixel, target: reflector, sigma: 0.05, intrinsics: {fx: 4000, fy: 4000, cx: 2000, cy: 1500},"
    " camera: {frame: base_link, xyz: [0.5, 0, 2.5], rpy: [180 deg, 0 deg, 0 deg]},"
    " points: {p: [0, 0, 0], x: [0.1, 0, 0], y: [0, 0.1, 0], z: [0, 0, 0.1]}}"
)
INCLINOMETER = "{kind: orientation, target: reflector, axes: gravity, sigma: 0.02 mrad}"
POINTER = "{kind: position, target: reflector, sigma: 0.02 mm}"


def each_axis(far, n=2):
    """Functions that move readings along one of n axes each."""
    return [lambda values, axis=axis: values + far * axis for axis in np.eye(n)]


@pytest.mark.quick(2)
@pytest.mark.parametrize(
    ("instruments", "quantity", "stated", "changes"),
    [
        ({}, SCALE, {"scale": "10 um/m"}, [lambda v: v * (1 + 5e-6)]),
        ({}, OFFSET, {"offset": "15 um"}, each_axis(7.5e-6, 3)),
        ({"eye": CAMERA}, FOCAL_LENGTH, {"focal_length": "20 ppm"}, [lambda v: v + 1e-5 * (v - [2000, 1500])]),
        ({"eye": CAMERA}, PRINCIPAL_POINT, {"principal_point": "0.02 px"}, each_axis(1e-2)),
        ({"level": INCLINOMETER, "ball": POINTER}, OFFSET_ANGLE, {"offset_angle": "0.02 mrad"}, each_axis(1e-5)),
    ],
)
def test_what_an_instrument_is_off_reaches_the_tool_as_a_fit_of_such_readings_says(
    tmp_path, instruments, quantity, stated, changes
):
    lines = "".join(f"  {name}: {text}\n" for name, text in instruments.items())
    more = f"instruments:\n{lines}" if instruments else ""
    robot = calib.load(copied(tmp_path, EXAMPLES / "arm.yaml", KNOWN, more=more))
    data = calib.simulate(robot, robot.sample(60, seed=1), seed=1)
    fit, first = calib.fit(robot, data), robot.instruments[0].name
    squares = 0.0
    for change in changes:
        read = data.readings[first]
        moved = replace(data, readings=data.readings | {first: replace(read, values=change(read.values))})
        again, before = (one.robot.positions(data.joints)[:, 0] for one in (calib.fit(robot, moved), fit))
        if fit.reported_uncertainty.motion is not None:  # positions count beside what moves all of them as one body
            rotation, shift = best_transform(again, before)
            again = again @ rotation.T + shift
        squares += np.mean((again - before) ** 2)
    known = TraceabilitySection.model_validate({"instrument": stated})
    found = contributions(budget(ErrorPropagation.from_fit(fit), known))
    assert found[quantity] == pytest.approx(math.sqrt(squares), rel=0.05)
    assert (SCALE in found) == ("eye" not in instruments)


@pytest.mark.quick(0)
@pytest.mark.amount(0, 40)
def test_monte_carlo_draws_the_sizes_of_joint_terms(arm, measured, amount):
    linear = ErrorPropagation.from_fit(calib.fit(arm, *measured, terms="curve"))
    known = budget(linear, TRACEABILITY)
    assert contributions(known)[SIZES] > 0
    drawn = monte_carlo(linear, TRACEABILITY, known, draws=amount)
    assert drawn.difference < 1.4 / np.sqrt(amount)  # two standard deviations
