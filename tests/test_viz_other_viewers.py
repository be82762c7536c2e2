"""The same scene in viser and as a recording for rerun, where these packages are installed."""

import numpy as np
import pytest
from viz_examples import five_bar_fit, medrue_fit

from calib.core.base.errors import InputError
from viz.inputs import gather


def test_a_recording_holds_every_row_and_the_errors_of_each(tmp_path):
    pytest.importorskip("rerun", reason="extra 'rerun'")
    from viz.recording import recording
    from viz.scene import scene_of_fit

    fit = five_bar_fit()
    scene = scene_of_fit(fit)
    content = recording(scene)
    assert content.startswith(b"RRF2")
    assert len(content) < 3e6
    path = tmp_path / "fit.rrd"
    path.write_bytes(content)
    entities = entity_paths(path)
    assert {"/errors/position/before", "/errors/position/after", "/scene/position/after"} <= entities
    assert {f"/scene/robot/{k}" for k in range(len(scene.bodies.names))} <= entities


def entity_paths(path):
    """What a recording has entries of, as rerun itself reads it."""
    from rerun.experimental import RrdReader

    (store,) = (entry for entry in RrdReader(path).store_entries() if "Recording" in str(entry.kind))
    return set(RrdReader(path).stream(store).collect().schema().entity_paths())


def test_a_target_that_is_dragged_brings_the_robot_there():
    pytest.importorskip("viser", reason="extra 'viser'")
    from viz.drag import DraggedView

    fit = medrue_fit()
    robot = fit.robot
    with DraggedView(gather(fit.nominal, fit)) as view:
        assert view.url.startswith("http://127.0.0.1:")
        start = robot.positions(view.joints[None, :])[0, 0]
        view.reach(start + [0.01, 0.0, 0.005])
        np.testing.assert_allclose(robot.positions(view.joints[None, :])[0, 0], start + [0.01, 0.0, 0.005], atol=1e-6)
        held = view.joints.copy()
        view.reach(start + [50.0, 0.0, 0.0])  # out of reach: it stays
        np.testing.assert_array_equal(view.joints, held)
        assert "not reached" in view.note.content


@pytest.mark.parametrize("package", ["rerun", "viser"])
def test_without_the_package_one_line_says_what_to_install(package, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, package, None)
    fit = five_bar_fit()
    shown = gather(fit.nominal, fit)
    with pytest.raises(InputError, match=rf"pip install medrue\[{package}\]"):
        if package == "rerun":
            from viz.recording import recording

            recording(shown.scene)
        else:
            from viz.drag import DraggedView

            DraggedView(shown)
