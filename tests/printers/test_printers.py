"""Delta printers: read from their firmwares, calibrated from what they probe, and written back."""

import json
import re

import numpy as np
import pytest
from click.testing import CliRunner

import calib
from calib.cli import group
from calib.core.base.errors import CalibrationError
from calib.core.rows.simulate import simulate
from calib.printers.files import read_printer
from calib.printers.formats import geometry_of
from calib.printers.rows import expected_geometry, residuals
from tests.code_comparison.codes.delta_printer import calibrated, nozzle
from viz.reading_errors import reading_errors_of_fit
from viz.report_tables import Headline

TRUE = np.array([103.3, 210.12, 329.85, 90.0, 208.25, 207.95, 208.1, 240.9, 241.6, 240.4])
STEP = 32 / (200 * 16)


def carriages(p, xyz):
    """How far carriages come down so that the nozzle is at xyz, (3,) [mm], by hand."""
    towers = p[0] * np.column_stack([np.cos(np.radians(p[1:4])), np.sin(np.radians(p[1:4]))])
    across = np.sum((towers - xyz[:2]) ** 2, axis=1)
    return p[7:10] + np.sqrt(p[4:7] ** 2 - p[0] ** 2) - (xyz[2] + np.sqrt(p[4:7] ** 2 - across))


def as_firmware(firmware, text):
    """R, angles, arms and endstops as TRUE has them, by what each firmware's source does with its lines, [mm, deg].

    Marlin homes to (0, 0, H - Z of M851) after it has come down from the switches by -M666. RepRapFirmware has its
    switches at H + sqrt(L^2 - R^2) + M666.
    """
    number = r"(-?\d+\.?\d*)"
    if firmware == "klipper":
        keys = ("delta_radius", "angle", "arm_length", "position_endstop")
        return np.array([float(value) for key in keys for value in re.findall(rf"{key}: {number}", text)])
    lines = [line.split(";")[0].split() for line in text.splitlines()]
    words = {line[0]: {word[0]: word[1:] for word in line[1:]} for line in lines if line}

    def three(code, keys):
        return np.array([float(words.get(code, {}).get(key, 0)) for key in keys])

    rods = np.array([float(rod) for rod in words["M665"]["L"].split(":")]) * np.ones(3)
    height, ends = float(words["M665"]["H"]), three("M666", "XYZ")
    if firmware == "marlin":
        rods, height, ends = rods + three("M665", "ABC"), height - three("M851", "Z")[0], -ends
        assert min(ends) >= 0
    angles = np.array([210, 330, 90]) + three("M665", "XYZ")
    return np.concatenate([[float(words["M665"]["R"])], angles, rods, height + ends])


def printer_cfg(seed=0, noise=0.01, spans=True, behind=False, true=TRUE, offset=16.0):
    """A printer.cfg as Klipper writes it, of a simulated printer; `behind`: saved by SAVE_CONFIG."""
    rng = np.random.default_rng(seed)
    lines = ["[printer]", "kinematics: delta", f"delta_radius: {true[0]}", ""]
    for k, tower in enumerate("abc"):
        lines += [f"[stepper_{tower}]  # tower", f"position_endstop: {true[7 + k]}", f"arm_length: {true[4 + k]}"]
        lines += [f"angle: {true[1 + k]}", "rotation_distance: 32", "microsteps: 16", ""]
    body = ["[delta_calibrate]", "radius: 80"]

    def steps(xyz):
        return ",".join(f"{item:.3f}" for item in carriages(true, xyz) / STEP)

    for k in range(13):
        angle, radius = np.radians(90 + 60 * k), 0 if k == 0 else (75 if k < 7 else 45)
        place = np.array([radius * np.cos(angle), radius * np.sin(angle), offset + noise * rng.standard_normal()])
        body += [f"height{k}: {offset}", f"height{k}_pos: {steps(place)}"]
    for k in range(12 if spans else 0):
        turns = np.radians([60 * k, 60 * k + (0 if k < 6 else 60)])  # spokes, then the rim of a hexagon
        radii = (5 if k < 6 else 68, 68)
        ends = [np.array([r * np.cos(t), r * np.sin(t), 1.0]) for r, t in zip(radii, turns, strict=True)]
        length = np.linalg.norm(ends[0] - ends[1]) + 2 * noise * rng.standard_normal()
        body += [f"distance{k}: {length:.3f}", *(f"distance{k}_pos{n}: {steps(end)}" for n, end in enumerate(ends, 1))]
    return "\n".join([*lines, *(f"#*# {line}" if behind else line for line in body), ""])


def run(*arguments):
    return CliRunner().invoke(group, [str(argument) for argument in arguments])


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "printer.cfg").write_text(printer_cfg())
    return tmp_path


def described(name="printer.cfg"):
    """The robot of settings, written as p.yaml and p.csv."""
    done = run("init", "--klipper", name, "--out", "p.yaml")
    assert done.exit_code == 0, done.output
    return calib.load("p.yaml")


def seven_heights():
    """Settings with the first seven heights alone."""
    lines = printer_cfg(spans=False).split("\n")
    return "\n".join(line for line in lines if not any(f"height{k}" in line for k in range(7, 13)))


def test_the_robot_is_where_three_spheres_meet_and_its_derivatives_are_right(folder):
    robot, rng = described(), np.random.default_rng(1)
    scale = np.array([p.sigma_si for p in robot.parameters])
    robot = robot.with_parameters(robot.values + scale * rng.standard_normal(len(scale)))
    g = geometry_of(robot)
    p = np.array([1e3 * g.radius, *np.degrees(g.angles), *(1e3 * np.array(g.arms)), *(1e3 * np.array(g.endstops))])
    places = rng.uniform([-60, -60, 5], [60, 60, 80], (4, 3))
    q = 1e-3 * np.array([[*carriages(p, place), *carriages(p, places[0])] for place in places])
    assert np.allclose(1e3 * robot.positions(q)[:, 0], places, atol=1e-9)
    assert np.allclose(1e3 * g.nozzle(q[:, :3]), places, atol=1e-9)
    assert np.allclose([nozzle(p, 1e3 * pose[:3]) for pose in q], places, atol=1e-6)
    plugin = robot.parametrisation
    twists = plugin.twists(robot.values)
    for k, size in enumerate(scale):
        ends = [plugin.placements(robot.values + sign * 1e-3 * size * np.eye(9)[k]) for sign in (1, -1)]
        for name, twist in twists.items():
            moved = (ends[0][name].translation - ends[1][name].translation) / (2e-3 * size)
            turned = plugin.placements(robot.values)[name].rotation
            assert np.allclose(turned @ twist[:3, k], moved, atol=1e-6)


def test_a_simulated_printer_is_found_from_its_printer_cfg_and_written_back(folder):
    """Heights and distances with 0.01 and 0.02 mm of noise; the design is off by up to 0.7 mm and 0.15 deg."""
    done = run("init", "--klipper", "printer.cfg", "--out", "p.yaml")
    assert "with 13 heights and 12 distances" in done.output
    done = run("fit", "p.yaml", "p.csv", "--out", "out", "--no-pages")
    assert done.exit_code == 0, done.output
    for firmware in ("klipper", "marlin", "duet"):
        done = run("export", "out", "--format", firmware, "--out", f"{firmware}.txt")
        assert done.exit_code == 0, done.output
    (folder / "part.gcode").write_text("G1 X0 Y0 Z5\n")  # for a firmware whose numbers the description does not have
    done = run("compensate", "out", "part.gcode", "--out", "c.gcode")
    assert done.exit_code == 2
    assert "holds the result itself: calib export --format klipper" in done.output
    ours = geometry_of(calib.load("out"))
    places = np.random.default_rng(5).uniform([-60, -60, 1], [60, 60, 40], (50, 3))
    down = 1e-3 * np.array([carriages(TRUE, place) for place in places])
    assert np.abs(1e3 * ours.nozzle(down) - places)[:, 2].max() < 0.04
    for firmware in ("klipper", "marlin", "duet"):
        p = as_firmware(firmware, (folder / f"{firmware}.txt").read_text())
        down = 1e-3 * np.array([carriages(p, place) for place in places])
        assert np.abs(1e3 * ours.nozzle(down) - places).max() < 5e-4  # the lines have four decimals


def test_a_fit_shows_the_errors_of_what_the_owner_has_saved(folder):
    described()
    printer = read_printer("printer.cfg", "klipper")
    errors = 1e3 * residuals(printer.geometry, printer.rows)
    heights = printer.rows.is_height
    fit = calib.fit("p.yaml", "p.csv")
    report, height = fit.report(), np.sqrt(np.mean(errors[heights] ** 2))
    drawn = next(table for table in reading_errors_of_fit(fit) if table.part.name == "height")
    assert Headline.from_fit(fit).before["rms"] == pytest.approx(height, rel=1e-6)
    assert 1e3 * np.sqrt(np.mean(np.sum(drawn.before**2, axis=1))) == pytest.approx(height, rel=1e-6)
    for part, some in (("height", heights), ("distance", ~heights)):
        before, designed = (
            re.search(rf"{part} \[mm\], {row} +25 +([\d.]+) -> ", report)[1]
            for row in ("identification", "as designed")
        )
        assert float(before) == pytest.approx(np.sqrt(np.mean(errors[some] ** 2)), abs=6e-5)
        assert float(designed) > 2 * float(before)
    text = (folder / "p.yaml").read_text()
    (folder / "p.yaml").write_text(text.replace("in_use: {delta_radius", "in_use: {radius"))
    with pytest.raises(CalibrationError, match=r"p\.yaml: in_use.*'radius'.*delta_radius"):
        calib.load("p.yaml")


def test_what_probing_cannot_know_stays_as_designed(folder):
    """Seven heights alone would give arms of any length: these are held, and angles stay near the design."""
    (folder / "printer.cfg").write_text(seven_heights())
    geometry = geometry_of(calib.fit(described(), "p.csv").robot)
    assert np.allclose(1e3 * np.array(geometry.arms), TRUE[4:7], atol=1e-6)
    assert np.abs(np.degrees(geometry.angles) - [210, 330, 90]).max() < 0.6


def test_seven_heights_do_not_say_that_a_carriage_moves_too_far(folder):
    """They leave one degree of freedom or two, and three scales none: noise that is small by chance made them sure."""
    (folder / "printer.cfg").write_text(seven_heights())
    robot = described()
    q = calib.read_measurements("p.csv", robot).joints
    for seed in range(5):
        rng = np.random.default_rng(seed)
        free = [p for p, is_free in zip(robot.parameters, robot.is_free, strict=True) if is_free]
        real = robot.with_parameters({p.name: p.nominal_si + p.sigma_si * rng.standard_normal() for p in free})
        reasons = calib.fit(robot, simulate(real, q, 2e-5, rng)).verdict.reasons
        assert "joint_scaled" not in [reason.code for reason in reasons]


def test_saved_rows_and_gears_count_and_included_files_are_named(folder):
    (folder / "saved.cfg").write_text(printer_cfg(behind=True))
    plain, saved = (read_printer(name, "klipper") for name in ("printer.cfg", "saved.cfg"))
    np.testing.assert_array_equal(plain.rows.places, saved.rows.places)
    (folder / "geared.cfg").write_text(GOOD.replace("distance: 32", "distance: 96\ngear_ratio: 80:20, 3:4"))
    geared = read_printer("geared.cfg", "klipper")
    np.testing.assert_allclose(geared.rows.places, plain.rows.places, rtol=1e-12)
    (folder / "main.cfg").write_text("[include printer.cfg]\n")
    with pytest.raises(CalibrationError, match="it may be in a file that is included"):
        read_printer("main.cfg", "klipper")


def test_the_design_is_expected_and_not_what_a_firmware_made_of_the_same_rows(folder):
    expected = expected_geometry(read_printer("printer.cfg", "klipper"))
    assert np.allclose(1e3 * np.array(expected.arms), 208)
    assert np.allclose(np.degrees(expected.angles), [210, 330, 90])
    assert np.allclose(1e3 * np.array(expected.endstops), 241)
    turned = GOOD.replace("angle: 90.0", "angle: 270").replace("angle: 210.12", "angle: 30.12")
    (folder / "turned.cfg").write_text(turned.replace("angle: 329.85", "angle: 149.85"))
    expected = expected_geometry(read_printer("turned.cfg", "klipper"))
    assert np.allclose(np.degrees(expected.angles), [30, 150, 270])  # tower c says how the printer's axes lie
    assert np.allclose(expected_geometry(read_printer("printer.cfg", "klipper"), 0.2085).arms, 0.2085)


@pytest.mark.quick(1)
@pytest.mark.parametrize(("k", "off"), [(0, 0.0), (1, -1.0), (4, 0.7), (9, -0.7)])
def test_a_mistyped_distance_is_named_though_a_firmware_made_its_settings_of_it(folder, k, off):
    """Klipper's fit takes in most of it: it is 0.5 mm off or less in the saved settings, and 0.7 or 1 mm to others."""
    text = re.sub(rf"distance{k}: (.*)", lambda m: f"distance{k}: {float(m[1]) + off:.3f}", printer_cfg())
    found = re.findall(r"^((?:height|distance)\d+): (.*)\n\w+: (.*)(?:\ndistance\d+_pos2: (.*))?", text, re.MULTILINE)
    rows = [(float(value), [STEP * np.array(e.split(","), float) for e in ends if e]) for _, value, *ends in found]
    p, misses = calibrated(TRUE, rows)
    assert off == 0 or abs(misses[[name for name, *_ in found].index(f"distance{k}")]) < 0.75 * abs(off)
    saved = [f"#*# [printer]\n#*# delta_radius = {p[0]:.6f}"]
    for i, tower in enumerate("abc"):
        numbers = zip(("angle", "arm_length", "position_endstop"), p[[1 + i, 4 + i, 7 + i]], strict=True)
        saved += [f"#*# [stepper_{tower}]", *(f"#*# {key} = {value:.6f}" for key, value in numbers)]
    (folder / "saved.cfg").write_text("\n".join([text, *saved]))
    done = run("init", "--klipper", "saved.cfg", "--out", "s.yaml")
    assert done.exit_code == (2 if off else 0), done.output
    assert not off or f": distance{k} " in done.output


def test_arms_that_no_printer_has_do_not_come_out(folder):
    """A firmware that fitted arms to heights alone may have saved such arms; its file agrees with itself."""
    (folder / "saved.cfg").write_text(printer_cfg(spans=False, true=np.array([*TRUE[:4], 225, 391, 214, *TRUE[7:]])))
    done = run("init", "--klipper", "saved.cfg", "--out", "s.yaml")
    assert done.exit_code == 2
    assert "arms of 225, 391, 214 mm, but all arms of a printer have one length" in done.output
    assert not (folder / "s.yaml").exists()


GOOD = printer_cfg()
BAD_KLIPPER = [
    (GOOD, "", "[printer] has no 'kinematics'"),
    ("kinematics: delta", "kinematics: corexy", "kinematics is not 'delta'"),
    ("delta_radius: 103.3", "", "[printer] has no 'delta_radius'"),
    ("delta_radius: 103.3", "delta_radius: wide", "line 3: delta_radius 'wide' is not a number"),
    ("delta_radius: 103.3", "delta_radius: 303.3", "reach nothing; correct delta_radius or arm_length"),
    ("angle: 210.12", "angle: 30", "tower a is at 30 deg, and tower c at 90 deg; towers are 120 deg apart"),
    ("endstop: 240.9", "endstop: -240.9", "switch of tower a would trip with the nozzle at -240.9 mm"),
    ("[stepper_b]", "[stepper_x]", "no [stepper_b]; a delta has stepper_a, stepper_b and stepper_c"),
    ("kinematics: delta", "kinematics: rotary_delta", "only deltas with carriages on towers can be read here. Begin"),
    ("arm_length: 208.25", "", "[stepper_a] has no 'arm_length'"),
    ("position_endstop: 240.9", "", "[stepper_a] has no 'position_endstop'"),
    ("microsteps: 16", "", "[stepper_a] has no 'microsteps'"),
    ("rotation_distance: 32", "", "[stepper_a] has no 'rotation_distance'"),
    ("rotation_distance: 32", "rotation_distance: 0", "must be positive"),
    ("rotation_distance: 32", "rotation_distance: 40", "probe again"),
    ("microsteps: 16", "microsteps: 32", "they fit [stepper_a] microsteps: 16 in place of 32, [stepper_b]"),
    (
        "angle: 210.12\nrotation_distance: 32\nmicrosteps: 16",
        "angle: 210.12\nrotation_distance: 32\nmicrosteps: 64",
        "they fit [stepper_a] microsteps: 16 in place of 64: write",
    ),
    ("arm_length", "gear_ratio: 5 to 1\narm_length", "gear_ratio '5 to 1' is not a ratio such as 5:1"),
    ("height3: 16.0", "height3: 16.6", "height3 is 16.6 mm, and all others are 16 mm, the offset of the probe"),
    ("height3: 16.0", "height3: high", "height3 'high' is not a number"),
    ("height3_pos: ", "height3_posn: ", "[delta_calibrate] has no 'height3_pos'"),
    ("distance4_pos2: ", "distance4_pos3: ", "[delta_calibrate] has no 'distance4_pos2'"),
    ("height3_pos: ", "height3_pos: 5,", "height3_pos '5,"),
    ("height3_pos: ", "height3_pos: 1", "height3 16 mm is"),
    ("distance4: 62", "distance4: 26", "distance4 26"),
    ("distance4: 62", "distance4: -62", "is not a distance"),
    ("height", "depth", "has distances and no heights"),
]


@pytest.mark.parametrize(("old", "new", "said"), BAD_KLIPPER)
def test_what_is_wrong_in_a_printer_cfg_is_named(folder, old, new, said):
    assert old in GOOD
    (folder / "bad.cfg").write_text(GOOD.replace(old, new))
    with pytest.raises(CalibrationError) as error:
        read_printer("bad.cfg", "klipper")
    assert said in str(error.value)
    assert "bad.cfg" in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("firmware", "text", "said"),
    [
        ("marlin", "", "no M665 with L"),
        ("marlin", "M665 L208", "no M665 with R, the radius"),
        (
            "marlin",
            "arm_length 250.0 # mm\narm_radius 124.0\ngamma_max 330\nalpha_trim -0.2\n",
            "settings of Smoothieware; write the lines 'M665 L250.0 R124.0 H330' and 'M666 X-0.2 Y0 Z0'",
        ),
        (
            "duet",
            "EPR:3 881 250.00 Diagonal rod length [mm]\nEPR:3 885 125.5 Horizontal rod radius at 0,0 [mm]\n",
            "settings of Repetier; write the lines 'M665 L250.00 R125.5 H<Z max length>'",
        ),
        ("klipper", "arm_length 250\narm_radius 124\n", "settings of Smoothieware; write the lines"),
        ("marlin", "arm_solution rotary_delta\ndelta_e 131.6\n", "is a rotary delta (arms that turn)"),
        ("duet", "M665 L208 R103", "no M665 with H, the height"),
        ("duet", "M665 L208:209 R103 H240", "M665 L has 2 rods"),
        ("duet", "M665 L208:208:208:208 R103 H240", "M665 L has 4 rods"),
        ("duet", "M665 L208 R103 H240 X0,1", "line 1: 'M665 L208 R103 H240 X0,1' is not M665 with letters and numbers"),
        ("duet", "M665 L208 R1..5 H240", "line 1: 'M665 L208 R1..5 H240' is not M665 with letters and numbers"),
        ("duet", "M665 L208 R103:103 H240", "is not M665 with letters and numbers; correct it"),
        ("duet", "G21\nM665 L{global.rod} R103 H240", "line 2: 'M665 L{GLOBAL.ROD}"),
        ("duet", "M665 L208 R103 H240\nM666 X0.1 Y0 Z-0.1 A0.2 B0", "M666 A0.2 tilts the bed in the firmware"),
        ("marlin", "M665 L208 R103 H240 X120", "tower a is at 330 deg, and tower c at 90 deg"),
        ("marlin", "M665 L208:208:208 R103 H240", "M665 L has 3 rods; Marlin has one length"),
        ("marlin", "M665 L208 R103 H240 S100 B80 X0 Y0 Z0", "M665 B80 would change a rod by 80 mm"),
        ("marlin", "M665 L208 R103 H240\nM666 X0.3 Y0 Z-1", "M666 X0.3 is positive, which Marlin refuses"),
        ("marlin", "  G20 ; (in)\n  M665 L8.2 R4.1 H9.4", "line 1: G20: lengths in inches"),
    ],
)
def test_what_is_wrong_in_settings_is_named(folder, firmware, text, said):
    (folder / "config.g").write_text(text + "\n")
    done = run("init", f"--{firmware}", "config.g", "--out", "p.yaml")
    assert done.exit_code == 2
    assert said in done.output
    assert not (folder / "p.yaml").exists()


@pytest.mark.parametrize(
    ("firmware", "text"),
    [
        ("duet", "M665 L208:208.2:208 R103.2 B90 H240 X0.1 Y-0.2 Z0 ; delta\nM666 X0.2 Y-0.5 Z0.3 A0 B0\n"),
        ("duet", "M665 R105.6 L215.0 B85 H235\nM666 X0 Y0 Z0\n"),
        (
            "marlin",
            "echo:  G21 ; (mm)\n  M666 X-0.2 Y0 Z-0.75\n  M665 L208 R103 H240 S80 X0.1 Y-0.2 Z0 A0.1 B-0.2 C0\n",
        ),
        ("marlin", "M665 L208 R103 H240 X0 Y0 Z0\nM666 X-0.2 Y0 Z-1\nM851 X0 Y0 Z-15.9 ; probe\n"),
    ],
)
def test_settings_are_the_machine_that_the_firmware_makes_of_them(folder, firmware, text):
    (folder / "settings.txt").write_text(text)
    plain = text.replace("echo:", "")
    done = run("init", f"--{firmware}", "settings.txt", "--out", "p.yaml")
    assert done.exit_code == 0, done.output
    places = np.random.default_rng(7).uniform([-60, -60, 0], [60, 60, 60], (20, 3))
    down = 1e-3 * np.array([carriages(as_firmware(firmware, plain), place) for place in places])
    assert np.abs(1e3 * calib.load("p.yaml").positions(down)[:, 0] - places).max() < 1e-6


def test_settings_alone_make_a_robot_and_others_are_no_printer(folder):
    (folder / "config.g").write_text("M665 L208 R103.2 H240\n")
    assert run("init", "--duet", "config.g", "--out", "p.yaml").exit_code == 0
    assert calib.load("p.yaml").joint_names == ("a", "b", "c")
    assert run("init", "--template", "delta", "--out", "d.yaml").exit_code == 0
    done = run("export", "d.yaml", "--format", "klipper", "--out", "no.txt")
    assert done.exit_code == 2
    assert "is not a delta printer" in done.output
    for refused in (["--target", "x"], ["--length", "rod=3mm"], ["--length", "arm=288"], ["--template", "delta"]):
        assert run("init", "--duet", "config.g", "--out", "n.yaml", *refused).exit_code == 2
    assert json.dumps(sorted(path.name for path in folder.iterdir())).count("n.yaml") == 0


def test_check_looks_at_what_was_measured_heights_and_distances(folder):
    """At a probed height both copies of the robot are at one place, where a distance has no direction."""
    described()
    done = run("check", "p.yaml", "p.csv")
    assert done.exit_code == 0, done.output
    assert done.output.startswith("25 poses (p.csv), 25 measured values")


@pytest.mark.quick(0)
def test_another_probing_verifies_a_fit_whatever_its_offset_and_its_rows(folder):
    """The fit has distances and heights with an offset of 16 mm; the later probing has heights alone, with 15.5 mm."""
    described()
    assert run("fit", "p.yaml", "p.csv", "--out", "out", "--no-pages").exit_code == 0
    (folder / "later.cfg").write_text(printer_cfg(spans=False, offset=15.5))
    done = run("init", "--klipper", "later.cfg", "--out", "later.yaml")
    assert re.search(r"errors of the settings in later.cfg: heights \d+\.\d{4} mm RMS; the firmware", done.output)
    done = run("verify", "out", "later.csv")
    assert done.exit_code == 0
    assert "AGREES" in done.output
