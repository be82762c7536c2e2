"""What a terminal says at the end: what the grade means, and a command that can be typed as it stands."""

import json
import shlex
import shutil

import numpy as np
import pytest

import calib
from calib.core.commands.next_steps import advice_after_fit
from calib.core.judging.reasons import Answer, Code, Verdict
from calib.planning.assessment_text import advice_after_check
from calib.planning.selection_text import advice_after_select
from tests.project import EXAMPLES


@pytest.fixture(scope="module")
def fit(robot, data):
    return calib.fit(robot, data)


@pytest.fixture
def say(monkeypatch):
    """Let the verdict on any fit be this grade, for these reasons."""

    def verdict(grade, *codes):
        reasons = tuple(Code(code).says("", grade=grade) for code in codes)
        for module in ("calib.core.commands.next_steps", "calib.core.judging.next_step"):
            monkeypatch.setattr(f"{module}.judge", lambda fit: Verdict(grade, reasons))

    return verdict


def advice(fit, typed=None, out="out", data="d.csv", **options):
    """What a terminal says after a fit of `a.yaml`."""
    return advice_after_fit(fit, "a.yaml", (data,), out, typed or {}, **options)


@pytest.mark.parametrize(
    ("grade", "codes", "expected"),
    [
        ("PASS", (), "calib fit a.yaml 'my data.csv' --validate 0.25 --out out"),
        ("CHECK", ("systematic", "outliers"), "calib fit a.yaml 'my data.csv' --exclude-outliers --out out-2"),
        ("CHECK", ("systematic",), "calib fit a.yaml 'my data.csv' --terms auto --out out-2"),
        ("CHECK", ("at_bounds", "joint_never_moved"), "calib check a.yaml 'my data.csv'"),
        ("FAIL", ("likely_mistake", "outliers", "systematic"), "calib fit a.yaml 'my data.csv' --out out-2"),
        ("FAIL", ("far_from_nominal",), "calib view a.yaml --result out"),
        ("FAIL", ("not_converged",), "calib fit a.yaml 'my data.csv' --starts 5 --out out-2"),
    ],
)
def test_the_first_reason_that_a_command_answers_says_which(fit, say, grade, codes, expected):
    say(grade, *codes)
    meaning, following = advice(fit, data="my data.csv").splitlines()
    assert grade in meaning
    assert following.startswith("Next: ")
    assert following.partition(": calib ")[2].startswith(expected.removeprefix("calib "))
    assert ("with --out out, then" in advice(fit, written=False)) is ("--result out" in expected)


def test_joint_terms_are_not_offered_where_poses_are_too_few_to_choose_them(robot, data, say):
    fit = calib.fit(robot, data[np.arange(15)])
    say("FAIL", "systematic")
    assert advice(fit).endswith(": calib check a.yaml d.csv")


def test_what_passed_on_other_poses_goes_on_to_be_used(robot, data, say):
    used, held = data.split(validation=0.25, seed=1)
    validated = calib.fit(robot, used, validation=held)
    say("PASS")
    use = "Next: use my out/calibrated.urdf, or correct a program by it: calib compensate 'my out' program.csv --out"
    assert advice(validated, out="my out").splitlines()[1] == f"{use} compensated.csv"
    unwritten = "Next: fit again with --out out, then use out/calibrated.urdf"
    assert unwritten in advice(validated, written=False)
    say("PASS", "nothing_to_correct")
    assert advice(validated).endswith(": calib verify out measured.csv")
    say("PASS", "nothing_to_correct", "systematic")  # an error is left that no parameter describes
    assert "--terms auto" in advice(validated)


def test_a_printer_gets_the_settings_of_its_firmware(say, tmp_path, run_calib):
    run_calib("init", "--klipper", EXAMPLES / "printer.cfg", "--out", tmp_path / "printer.yaml")
    printer = calib.load(tmp_path / "printer.yaml")
    fit = calib.fit(printer, tmp_path / "printer.csv", validation=tmp_path / "printer.csv")
    say("PASS")
    assert advice(fit).endswith(": calib export out --format klipper --out settings.cfg")


def test_a_result_that_no_urdf_can_hold_is_used_by_the_whole_model(robot, data, say, monkeypatch):
    validated = calib.fit(robot, data, validation=0.25)
    monkeypatch.setattr("calib.core.judging.next_step.why_no_origins", lambda fit: "its joint terms matter")
    say("PASS")
    assert ": calib compensate out program.csv --out" in advice(validated)
    assert "urdf" not in advice(validated)


def test_a_check_leads_to_poses_to_measure_or_to_a_fit_with_what_the_next_command_knows(robot, data):
    assessment, poses, files = calib.check(robot, data), calib.as_poses(robot, data.joints), ("d.csv",)
    assert "calib sample" in advice_after_check(assessment, "a.yaml", data, (), {})
    typed = {"--sigma-mm": ("0.3",), "--seed": ("3",), "--task": ("my task.csv",)}
    for given, sigma, task in (({}, "", ""), (typed, " --sigma-mm 0.3", " --task 'my task.csv'")):
        to_fit, to_select = (advice_after_check(assessment, "a.yaml", of, files, given) for of in (data, poses))
        assert f" calib fit a.yaml d.csv{sigma} --validate 0.25" in to_fit
        assert to_select.endswith(f" calib select a.yaml d.csv --count 40{sigma}{task} --out chosen.csv")
        assert advice_after_select("a.yaml", "b.csv", given).endswith(f"--candidates b.csv{sigma}")
    still = calib.check(robot.fix("reflector.x"), data[[0] * 20])
    assert still.determination.missing
    hold = "Next: hold parameters that are named above (`held` in the description), or add poses, and check again: "
    for of in (poses, data):
        assert advice_after_check(still, "a.yaml", of, files, {}) == f"{hold}calib check a.yaml d.csv"


@pytest.mark.quick(0)
def test_what_is_offered_can_be_typed_as_it_stands(run_calib, tmp_path):
    robot, data = EXAMPLES / "arm.yaml", EXAMPLES / "arm_simulated.csv"
    out = tmp_path / "my result"
    first = run_calib("fit", robot, data, "--out", out, "--no-pages").out.splitlines()[-1]
    again = run_calib(*shlex.split(first.partition(": calib ")[2]), "--no-pages")
    assert again.code == 0
    assert json.loads((out / "result.json").read_text())["next"].startswith("use DIR/calibrated.urdf, or ")
    last = again.out.splitlines()[-1]
    shutil.copy(data, tmp_path / "program.csv")
    assert run_calib(*shlex.split(last.partition(": calib ")[2]), cwd=tmp_path).code == 0
    assert advice_after_select("a.yaml", "b.csv", {}).endswith(
        "calib watch a.yaml measured.csv --goal 0.1mm --candidates b.csv"
    )


def test_a_noise_that_the_next_step_is_to_change_is_not_typed_again(fit, say, monkeypatch):
    typed = {"--sigma-mm": ("0.3",), "--seed": ("3",), "--exclude-outliers": ()}
    smaller = Code.NOISE.says("", answer=Answer.STATE_NOISE)
    monkeypatch.setattr("calib.core.judging.next_step.judge", lambda fit: Verdict("CHECK", (smaller,)))
    assert "0.3" not in advice(fit, typed)
    say("CHECK", "systematic")
    again = " calib fit a.yaml d.csv --terms auto --sigma-mm 0.3 --seed 3 --exclude-outliers --out out-2"
    assert advice(fit, typed).endswith(again)
    say("CHECK", "at_bounds", "joint_never_moved")
    assert advice(fit, typed).endswith(": calib check a.yaml d.csv --sigma-mm 0.3")


@pytest.mark.quick(0)
@pytest.mark.parametrize(
    "shell", ["bash", *(pytest.param(name, marks=pytest.mark.amount(0, 1)) for name in ("zsh", "fish"))]
)
def test_shells_complete_commands(spawn_calib, monkeypatch, shell):
    monkeypatch.setenv("_CALIB_COMPLETE", f"{shell}_complete")
    monkeypatch.setenv("COMP_WORDS", "calib wat")
    monkeypatch.setenv("COMP_CWORD", "wat" if shell == "fish" else "1")
    assert "watch" in spawn_calib().out


def test_a_tracker_that_moved_half_way_is_not_answered_by_joint_terms(robot, data):
    rows = {name: np.array(values) for name, values in data.to_dict().items()}
    (x,) = (name for name in rows if name.startswith("reflector_x"))
    rows[x] = rows[x].astype(float) + 0.5 * (np.arange(len(data)) >= 40)  # mm
    moved = calib.fit(robot, rows)
    first = moved.verdict.reasons[0]
    assert (first.grade, "or base had moved" in first.text) == ("CHECK", True)
    assert "describe setups" in first.text
    assert "--terms" not in advice(moved)


def test_result_json_and_the_terminal_offer_the_same_fit_with_the_options_that_were_typed(run_calib, tmp_path):
    robot, data = str(EXAMPLES / "arm.yaml"), str(EXAMPLES / "arm_simulated.csv")
    asked = {"--fix": "reflector.x, reflector.y, joint_3.y", "--free": "joint_3.y", "--prior": "joint_2.z = 0.1 mm",
             "--seed": "3", "--sigma-mm": "0.03"}  # fmt: skip
    options = [word for pair in asked.items() for word in pair]
    run = run_calib("fit", robot, data, *options, "--no-pages", "--out", "my result", cwd=tmp_path)
    result = tmp_path / "my result" / "result.json"
    command = shlex.split(json.loads(result.read_text())["next"].partition(": ")[2])
    assert "\nPASS: " in run.out or "\nCHECK: " in run.out or "\nFAIL: " in run.out  # no codes of a terminal
    assert "\x1b" not in run.out
    typed = shlex.split(run.out.rpartition("Next: ")[2].partition(": ")[2])
    typed.remove("--no-pages")
    files = {"ROBOT": robot, "DATA": data, "DIR": "my result"}
    assert [files.get(word, word) for word in command] == typed
    assert typed[:4] == ["calib", "fit", robot, data]
    for name, value in (asked | {"--validate": "0.25", "--out": "my result"}).items():
        assert typed[typed.index(name) + 1] == (value if name == "--out" else value.replace(" ", ""))
    assert len(set(typed)) == len(typed)
    assert run_calib(*typed[1:], "--no-pages", cwd=tmp_path).code == 0
    status = {row["name"]: row["status"] for row in json.loads(result.read_text())["parameters"]}
    assert status["reflector.x"] == status["reflector.y"] == "held"


def test_python_offers_what_it_was_asked_for(robot, data, say):
    fit = calib.fit(robot, data, fix="joint_2.y", prior={"joint_4.x": "0.2 mm"}, validation=0.25)
    say("CHECK", "systematic")
    offered = fit.to_dict()["next"].partition(": ")[2]
    asked = "--validate 0.25 --fix joint_2.y --prior joint_4.x=0.2mm --terms auto"
    assert sorted(offered.split()) == sorted(f"calib fit ROBOT DATA {asked} --out DIR-2".split())
