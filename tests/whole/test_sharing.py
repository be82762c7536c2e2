"""Results sent to other processes, fits in several threads and processes at once, and a thousand in one process."""

import ctypes
import dataclasses
import gc
import inspect
import os
import pickle
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import psutil
import pytest
from scipy.spatial.transform import Rotation

import calib
from calib.core.base.arrays import ReadOnlyArrays
from calib.core.calibrating.calibrate import calibrate
from calib.core.calibrating.file_robots import FitFiles
from calib.core.fitting.settings import Settings
from tests.project import EXAMPLES

pytestmark = pytest.mark.quick(0)

ROBOT, DATA = EXAMPLES / "five_bar.yaml", EXAMPLES / "five_bar_simulated.csv"
FITS = int(os.environ.get("CALIB_FITS", "15"))
"""How many fits one process does; CALIB_FITS=1000 is the long trial."""


@pytest.fixture(scope="module")
def robot():
    return calib.load(ROBOT)


@pytest.fixture(scope="module")
def data(robot):
    return calib.read_measurements(DATA, robot)


@pytest.fixture(scope="module")
def fitted(robot, data):
    return calib.fit(robot, data)


def matched(path):
    """A match to the poses that the arm's own kinematics give."""
    arm = calib.load(EXAMPLES / "arm.urdf")
    q = arm.sample(30, seed=1)
    T = np.linalg.inv(arm.forward(q, "base_link")) @ arm.forward(q, "flange")
    angles = Rotation.from_matrix(T[:, :3, :3]).as_euler("ZYX", degrees=True)
    rows = np.hstack([np.degrees(q), 1e3 * T[:, :3, 3], angles])
    np.savetxt(path, rows, fmt="%.4f", delimiter=",", header="A1,A2,A3,A4,A5,A6,X,Y,Z,A,B,C", comments="")
    return calib.match(EXAMPLES / "arm.urdf", path)


@pytest.fixture(scope="module")
def public_objects(robot, data, fitted, tmp_path_factory):
    """One of each public class, by its name."""
    poses = calib.read_poses(DATA, robot)
    folder = tmp_path_factory.mktemp("result") / "out"
    fitted.save(folder, pages=False)
    calib.fit(robot, calib.simulate(robot, poses, seed=2)).save(folder.with_name("other"), pages=False)
    watch = calib.Watch(robot, "0.1 mm", candidates=poses)
    errors = {name: getattr(calib, name)("what, where") for name in calib.__all__ if name.endswith("Error")}
    return errors | {
        "Acceptance": calib.verify(fitted, data),
        "Assessment": calib.check(robot, data),
        "Calibration": fitted,
        "Compensation": calib.compensate(fitted.robot, calib.Goals(robot.positions(poses.joints)[:, 0])),
        "Fit": calibrate(robot, data, None, Settings()),
        "Fleet": calib.fleet(folder, folder.with_name("other")),
        "Goals": calib.Goals(robot.positions(poses.joints)[:, 0]),
        "LoadedResult": calib.load_result(folder),
        "Holds": calib.Holds.ORIGINS,
        "Match": matched(folder.with_name("pairs.csv")),
        "Measurements": data,
        "Origin": calib.Origin(np.arange(3.0), np.zeros(3)),
        "Parameter": robot.parameters[0],
        "Poses": poses,
        "Progress": watch.update(data),
        "ResultComparison": calib.compare(fitted, calib.fit(robot, data[:30])),
        "Robot": fitted.robot,
        "Selection": calib.select(robot, poses, count=8),
        "Solution": calib.solve(robot, calib.Goals(robot.positions(poses.joints)[:, 0])),
        "Study": calib.study(robot, poses, draws=2, seed=1),
        "Watch": watch,
    }


def test_everything_public_is_tried(public_objects):
    classes = {name for name in calib.__all__ if inspect.isclass(getattr(calib, name))}
    assert set(public_objects) == classes - {"Parametrisation"}  # which others write
    for name, thing in public_objects.items():
        assert isinstance(thing, getattr(calib, name)), name


def test_everything_public_survives_pickling(public_objects):
    for name, thing in public_objects.items():
        again = pickle.loads(pickle.dumps(thing))
        assert type(again) is type(thing), name
        same(thing, again, name)
        if hasattr(thing, "report"):
            assert again.report() == thing.report()


def same(item, other, where, held=False):
    """Compare what two objects hold, down to the numbers; where a class holds its arrays fast, so must its copy."""
    if isinstance(item, FitFiles):  # which takes no measurements along
        item = dict(item)
    assert type(item) is type(other), where
    if isinstance(item, np.ndarray):
        np.testing.assert_array_equal(item, other, err_msg=where)
        assert not (held and other.flags.writeable), where
    elif dataclasses.is_dataclass(item):
        for field in (field for field in dataclasses.fields(item) if field.compare):  # the others are kept for speed
            parts = getattr(item, field.name), getattr(other, field.name)
            same(*parts, f"{where}.{field.name}", isinstance(item, ReadOnlyArrays))
    elif isinstance(item, dict):
        assert list(item) == list(other), where
        for key in item:
            same(item[key], other[key], f"{where}[{key!r}]", held)
    elif isinstance(item, tuple | list):
        assert len(item) == len(other), where
        for k, pair in enumerate(zip(item, other, strict=True)):
            same(*pair, f"{where}[{k}]", held)
    elif isinstance(item, float):
        assert item == other or (np.isnan(item) and np.isnan(other)), where
    elif isinstance(item, str | int | None):
        assert item == other, where


def test_four_threads_fit_at_once_and_get_the_numbers_of_one(robot, data, fitted):
    with ThreadPoolExecutor(4) as threads:
        result = list(threads.map(lambda _: calib.fit(robot, data), range(8)))
    for item in result:
        assert np.allclose(item.robot.values, fitted.robot.values, rtol=0, atol=1e-12)


FORKED = """
import multiprocessing, sys
import calib

def values(task):
    robot, data = task
    return calib.fit(robot, data)

if __name__ == "__main__":
    robot = calib.load(sys.argv[1])
    data = calib.read_measurements(sys.argv[2], robot)
    here = calib.fit(robot, data)
    for method in ("fork", "spawn"):
        with multiprocessing.get_context(method).Pool(2) as pool:
            for there in pool.map(values, [(robot, data)] * 2):
                assert abs(there.robot.values - here.robot.values).max() < 1e-12
        print(method)
"""


def test_forked_and_spawned_processes_fit_and_send_their_results_back(tmp_path):
    script = tmp_path / "program.py"
    script.write_text(FORKED)
    done = subprocess.run([sys.executable, script, ROBOT, DATA], capture_output=True, text=True, timeout=300)
    assert done.stdout.split() == ["fork", "spawn"], done.stderr


def memory():
    """What this process alone holds [bytes], after what can be freed was freed."""
    gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
    held = psutil.Process().memory_info()
    return held.rss - held.shared  # libraries count for nobody: who else has them loaded comes and goes


def test_many_fits_in_one_process_do_not_grow(robot, data, fitted):
    """One fit holds 170 kB when pickled, so that keeping any of each would show."""

    def work(times):
        for _ in range(times):
            loaded = calib.load(ROBOT)
            calib.fit(loaded, calib.read_measurements(DATA, loaded))

    work(5)
    before = memory()
    work(FITS)
    assert memory() - before < 2e6 + 1e3 * FITS  # what the allocator does not give back, and far less than one result
