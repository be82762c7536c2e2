"""Two cameras and a tracker that saw one real arm: what pixels that do not fit their camera do, and what is said of it.

The files have the pixels of an image that was turned by 90 degrees against that of the intrinsics.
"""

import csv
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.data.measurement_files import read_measurements

SHARED = Path(__file__).parents[2] / "shared" / "data" / "motoman_right"


@pytest.fixture(scope="module")
def motoman(tmp_path_factory):
    """Two cameras and a tracker that measured one real arm; its files, and fits of the instruments that are named."""
    if not (SHARED / "camera").is_dir():
        pytest.skip("the measurements are not part of the project")
    folder = tmp_path_factory.mktemp("motoman")
    poses, pixels, cameras = (
        list(csv.DictReader((SHARED / "camera" / f"{name}.csv").read_text().splitlines()))
        for name in ("poses", "pixels", "cameras")
    )
    markers = (SHARED / "camera" / "markers.csv").read_text().replace("marker,", "point,", 1)
    (folder / "markers.csv").write_text(markers)
    joints_ = [f"{name} [rad]" for name in "ESLURBT"]

    def fitted(tracker, turned):
        """Fit; `turned`: with the pixels in the image as the intrinsics have it, a quarter turn from the files."""
        yaml = f"urdf: {SHARED / 'robot.urdf'}\nname_mot: [E, S, L, U, R, B, T]\n"
        yaml += f"base: {{frame: l0, pose: {'unknown' if tracker else 'known'}}}\ntargets:\n"
        yaml += "  body: {frame: flange, position: unknown, orientation: unknown}\n"
        yaml += "  ball: {frame: flange, xyz: [0.045, 0, 0.245], position: unknown}\n" if tracker else ""
        yaml += "instruments:\n" + ("  ball: {kind: position}\n" if tracker else "")
        for row in cameras:
            numbers = ", ".join(f"{key.partition(' ')[0]}: {value}" for key, value in row.items() if key != "camera")
            yaml += f"  {row['camera']}: {{kind: pixel, target: body, camera: {{frame: l0}}, columns: pixel,"
            yaml += f" intrinsics: {{{numbers}}}, points_file: markers.csv}}\n"
        yaml += "columns: {u: pixel_u, v: pixel_v, marker: point}\nparametrisation:\n"
        yaml += "  - {origin: all, components: [x, y, z], sigma: 1 mm}\n"
        yaml += "  - {origin: all, components: [rx, ry, rz], sigma: 3 mrad}\n"
        (folder / "robot.yaml").write_text(yaml)
        robot = calib.load(folder / "robot.yaml")
        data = []
        for use in ("train", "test"):
            some = [row for row in poses if row["use"] == use]
            names = {row["pose"] for row in some}
            lines = [f"pose,{','.join(joints_)},ball_x,ball_y,ball_z" if tracker else f"pose,{','.join(joints_)}"]
            keys = ["pose", *joints_, *(["x [m]", "y [m]", "z [m]"] if tracker else [])]
            lines += [",".join(row[key] for key in keys) for row in some]
            (folder / "joints.csv").write_text("\n".join(lines) + "\n")
            lines = ["pose,camera,marker,u,v"]
            for row in pixels:
                u, v = float(row["u [px]"]), float(row["v [px]"])
                u, v = (v, 5999 - u) if turned else (u, v)
                lines += [f"{row['pose']},{row['camera']},{row['marker']},{u},{v}"] if row["pose"] in names else []
            (folder / "pixels.csv").write_text("\n".join(lines) + "\n")
            data.append(read_measurements([folder / "joints.csv", folder / "pixels.csv"], robot))
        return calib.fit(robot, data[0], validation=data[1])

    return fitted


def test_pixels_of_a_turned_image_do_not_pass_and_the_reason_is_said(motoman):
    fit = motoman(tracker=False, turned=False)
    assert fit.verdict.grade == "FAIL"
    words = " ".join(reason.text for reason in fit.verdict.reasons)
    assert "noise found of left, pixel, is 7" in words
    assert "camera 'left': 284 of 601 readings lie outside an image" in words
    assert "residuals are not only noise" in words


def test_pixels_and_tracker_together_are_no_worse_than_the_tracker_alone(motoman):
    fit = motoman(tracker=True, turned=True)
    assert all(one.sigma < 1.1 for one in fit.noise if one.group.part == "pixel")
    errors = fit.validation.errors("after")
    assert 1e3 * np.sqrt(np.mean(np.sum(errors**2, axis=1))) < 0.0726
