"""What a terminal shows of a fit: the answer on one screen, and with verbose all of it."""

import numpy as np
import pytest

import calib
from calib.core.judging.reasons import Reason, Verdict

LINES = 40


@pytest.fixture(scope="module")
def fit(robot, data):
    used, others = data.split(validation=0.25, seed=1)
    return calib.fit(robot, used, validation=others, folds=3)


def test_the_answer_has_verdict_errors_and_the_surest_changes(fit):
    lines = fit.report().splitlines()
    assert len(lines) <= LINES
    assert lines[1] == f"Verdict: {fit.verdict.grade}"
    table = fit.validation.table()
    pair = " -> ".join(f"{table[state]['rms']:.4f}" for state in ("before", "after"))
    assert pair in next(line for line in lines if line.startswith("position [mm], validation"))
    start = next(k for k, line in enumerate(lines) if line.startswith("changed most"))
    shown = [line.split() for line in lines[start + 1 :]]
    own = [each for each in fit.parameters.values() if each.status != "placed" and "reflector" not in each.name]
    changes = {each.name: abs(each.value - each.nominal) / each.std for each in own}
    surest = sorted(changes, key=changes.get, reverse=True)[:5]
    assert [row[0] for row in shown] == surest
    np.testing.assert_allclose([float(row[-1]) for row in shown], [changes[name] for name in surest], atol=0.051)


def test_many_long_reasons_do_not_fill_the_screen(fit, monkeypatch):
    told = Verdict("CHECK", tuple(Reason("CHECK", f"code_{k}", "word " * 50) for k in range(9)), ("limit " * 40,) * 3)
    monkeypatch.setattr("calib.core.results.report_text.judge", lambda fit: told)
    text = fit.report()
    assert len(text.splitlines()) <= LINES
    assert text.count("  CHECK: word") == 3
    assert "--verbose prints 6 more reasons" in text
    everything = fit.report(verbose=True)
    assert everything.count("  CHECK: word") == 9
    assert everything.count("  not covered: limit") == 3


def test_everything_has_all_parameters_and_the_noise(fit):
    text = fit.report(verbose=True)
    assert all(f"│ {name} " in text for name in fit.parameters)
    assert "Noise found" in text
    assert "Noise found" not in fit.report()
