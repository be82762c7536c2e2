"""`calib view`: writes pages, serves until it is stopped, and says in one line what is wrong."""

import http.client
import os
import re
import signal
import subprocess
import sys

import pytest
from click.testing import CliRunner

import medrue
from tests.child_programs import start
from tests.viz.viz_examples import LOST_MESH, medrue_fit
from viz.command import view

ROBOT = str(medrue.robot_file())


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("result") / "out"
    medrue_fit().save(str(path), pages=False)
    return str(path)


def run(*arguments):
    return CliRunner().invoke(view, list(arguments))


def test_a_page_is_written(tmp_path, folder):
    target = tmp_path / "view.html"
    outcome = run(ROBOT, "--result", folder, "--html", str(target))
    assert outcome.exit_code == 0, outcome.output
    assert "<title>medrue: calibration viewer</title>" in target.read_text(encoding="utf-8")


def test_quiet_prints_nothing(tmp_path):
    outcome = run(ROBOT, "--html", str(tmp_path / "view.html"), "--quiet")
    assert (outcome.exit_code, outcome.output) == (0, "")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([ROBOT, "--result", "nowhere"], "holds no result"),
        ([ROBOT, "--html", "/dev/null/view.html"], "cannot be written"),
        ([ROBOT, "--html", "view.html", "--port", "1"], "leave out --port"),
        ([ROBOT, "--port", "70000"], "not in the range"),
    ],
)
def test_wrong_input_ends_with_2_and_one_line(arguments, message):
    outcome = run(*arguments)
    assert outcome.exit_code == 2
    assert message in outcome.output
    assert "Traceback" not in outcome.output


def test_a_missing_mesh_is_told_and_is_no_error(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(LOST_MESH)
    outcome = run(str(path), "--html", str(tmp_path / "view.html"))
    assert outcome.exit_code == 0
    assert "lost.stl" in outcome.stderr


@pytest.mark.quick(0)
@pytest.mark.parametrize("end", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.amount(0, 1))])
def test_it_serves_until_it_is_stopped_and_then_ends_in_order(end, folder):
    program, pipe = "from viz.command import view; view()", subprocess.PIPE
    command = [sys.executable, "-c", program, ROBOT, "--result", folder, "--no-browser"]
    process = start(command, stdout=pipe, stderr=pipe, text=True)
    try:
        url = process.stdout.readline()
        port, path = re.fullmatch(r"http://127\.0\.0\.1:(\d+)(/.*/)\n", url).groups()
        connection = http.client.HTTPConnection("127.0.0.1", int(port), timeout=5)
        connection.request("GET", path)
        assert connection.getresponse().status == 200
        connection.close()
        process.stderr.readline()  # the command waits now
        os.kill(process.pid, end)
        assert process.wait(10) == 0
        with pytest.raises(ConnectionRefusedError):
            http.client.HTTPConnection("127.0.0.1", int(port), timeout=5).connect()
    finally:
        process.kill()
        process.communicate()
