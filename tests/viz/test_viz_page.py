"""The page: self-contained, escaped, the same bytes for the same scene, and true to the numbers it was given."""

import base64
import dataclasses
import hashlib
import json
import re
import warnings
from types import SimpleNamespace

import numpy as np
import pytest
import umsgpack

import calib
import viz
from calib.core.base.errors import InputError
from medrue.workspace import target_workspace
from tests.photographs import camera_scenes
from tests.signed_files import read_plain
from tests.viz.viz_examples import LOST_MESH, medrue_table, outside_addresses
from viz import poses
from viz.answer_page import _image_charts
from viz.drawing import draw
from viz.scene import build_scene
from viz.scene_data import certainty, point_pixels, ranges, scene_data, summary
from viz.shapes import Shape
from viz.viewer_page import ViewerPage, json_in_script, scene_page, script_safe

HOSTILE = "</script><img src=x onerror=alert(1)>"


@pytest.fixture(scope="module")
def scene():
    return medrue_scene()


def medrue_scene():
    q = target_workspace().q[::40]
    n = len(q)
    groups = ("identification",) * 5 + ("validation",) * (n - 5)
    known = {"spread": np.full((n, 3), 2e-5), "group": groups, "outlier": np.arange(n) == 2}
    return build_scene(*medrue_table(q, labels=(HOSTILE, *map(str, range(1, n))), **known))


def scene_of(page):
    return json.loads(re.search(r'<script type="application/json" id="scene">(.*?)</script>', page.html, re.S).group(1))


def floats(text):
    return np.frombuffer(base64.b64decode(text), dtype="<f8")


def test_the_page_holds_the_numbers(scene):
    data = scene_of(scene_page(scene))
    table = scene.poses
    for name, values in (
        ("measured", table.measured),
        ("before", table.error("before")),
        ("after", table.error("after")),
        ("joints", table.joints),
        ("spread", table.spread),
    ):
        np.testing.assert_array_equal(floats(data["table"][name]).reshape(values.shape), values)
    group = np.frombuffer(base64.b64decode(data["table"]["group"]), dtype=np.uint8)
    assert group.tolist() == [0, 0, len(poses.GROUPS), 0, 0, *[1] * (len(table) - 5)]
    assert data["table"]["labels"][0] == HOSTILE


def test_the_page_asks_nobody_runs_its_own_scripts_alone_and_names_who_wrote_them(scene):
    html = scene_page(scene).html
    assert "onerror=alert" not in html.replace("\\u003cimg src=x onerror=alert(1)\\u003e", "")  # from a file
    assert html.count("<script") == html.count("</script>")
    assert "connect-src 'none'" in html
    assert "default-src 'none'" in html
    assert outside_addresses(html) == []
    assert "Three.js Authors" in html
    (allowed,) = re.findall(r"script-src ([^;]*);", html)
    scripts = re.findall(r"<script>(.*?)</script>", html, re.S)
    digests = [base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts]
    assert allowed.split() == [f"'sha256-{digest}'" for digest in digests]


def test_the_same_scene_gives_the_same_bytes_and_five_thousand_poses_stay_small(scene):
    html = scene_page(scene).html
    assert html == scene_page(scene).html
    assert len(html) < 1.2e6
    per_pose = sum(len(text) for text in (scene_data(scene)["solid"]["values"], scene_data(scene)["ghost"]["values"]))
    assert per_pose / len(scene.poses) < 150  # bytes of joint values of both robots, base64


def test_a_saved_page_reads_back(tmp_path, scene):
    page = scene_page(scene)
    assert read_plain(page.save(tmp_path / "viewer.html")).decode().strip() == page.html.strip()
    with pytest.raises(InputError, match="cannot be written"):
        page.save(tmp_path / "no" / "viewer.html")


def test_a_notebook_shows_the_page_in_a_frame_of_its_own():
    shown = ViewerPage('<p class="a">&</p>')._repr_html_()
    assert 'srcdoc="&lt;p class=&quot;a&quot;&gt;&amp;&lt;/p&gt;"' in shown


def test_summary_and_ranges_are_in_their_units(scene):
    rows = {row["group"]: row for row in summary(scene)}
    lengths = 1e3 * np.linalg.norm(scene.poses.error("after")[:5], axis=1)
    expected = {"rms": np.sqrt(np.mean(lengths**2)), "max": lengths.max()}
    assert rows["identification"]["after"] == pytest.approx(expected)
    assert rows["validation"]["poses"] == len(scene.poses) - 5
    assert "measured" not in rows
    sizes = {state: np.linalg.norm(scene.poses.error(state), axis=1) for state in ("before", "after")}
    result = ranges(sizes, scene.poses.outlier)
    usual = sizes["after"][~scene.poses.outlier]
    shown = scene_data(scene)["parts"][0]["range"]
    assert shown["after"] == [0.0, pytest.approx(1e3 * np.quantile(usual, 0.95))]
    assert result["after"] == [0.0, pytest.approx(np.quantile(usual, 0.95))]
    assert 0 < result["both"][0] < result["after"][1] < result["both"][1]


def test_the_summary_counts_a_pose_with_several_points_once(scene):
    both = scene.poses.subset(np.repeat(np.arange(len(scene.poses)), 2))
    numbers = [row["poses"] for row in summary(dataclasses.replace(scene, poses=both))]
    assert numbers == [5, len(scene.poses) - 5]


def test_of_very_many_rows_the_page_holds_those_that_matter_and_says_so(scene, monkeypatch):
    whole = scene_data(scene)
    monkeypatch.setattr(poses, "_MOST_ROWS", 7)
    monkeypatch.setattr(poses, "WORST", 1)
    few = medrue_scene()
    part, n = scene_data(few), len(scene.poses)
    assert len(few.solid.values) == len(few.ghost.values) == 7  # loops of others need not be closed
    assert n > 7 == part["table"]["n"]
    assert any(f"7 of {n} rows" in note for note in part["notes"])
    assert not any("rows are in this page" in note for note in whole["notes"])
    assert (part["summary"], part["parts"]) == (whole["summary"], whole["parts"])
    kept = [scene.poses.labels.index(label) for label in part["table"]["labels"]]
    assert kept == sorted(kept)
    for state in ("before", "after"):
        assert int(np.argmax(np.linalg.norm(scene.poses.error(state), axis=1))) in kept
    for robot, posed in (("solid", scene.solid), ("ghost", scene.ghost)):
        values = np.frombuffer(base64.b64decode(part[robot]["values"]), "<f4").reshape(7, -1)
        np.testing.assert_allclose(values, posed.values[kept], rtol=1e-6, atol=1e-7)
    after = np.frombuffer(base64.b64decode(part["table"]["after"]), "<f8").reshape(-1, 3)
    np.testing.assert_array_equal(after, scene.poses.error("after")[kept])


def test_code_cannot_end_its_script():
    assert script_safe('a = "</script>"; b = "<!--";') == 'a = "<\\/script>"; b = "<\\!--";'
    text = json_in_script({"name": "</script>&\u2028"})
    assert not set("<>&\u2028") & set(text)
    assert json.loads(text) == {"name": "</script>&\u2028"}


def test_the_commands_draw_every_shape_under_its_link(scene):
    commands = [umsgpack.unpackb(command) for command in draw(scene)]
    drawn = [command for command in commands if command["type"] == "set_object"]
    assert len(drawn) == len(scene.shapes) + len(scene.decorations)
    paths = {command["path"] for command in drawn}
    assert any(re.fullmatch(r"/meshcat/robot/\d+ carriage/\d+", path) for path in paths)
    assert len(paths) == len(drawn)
    assert all(len(command["matrix"]) == 16 for command in commands if command["type"] == "set_transform")


def test_the_commands_are_meshcat_s_own(scene):
    """But for what three.js takes where nothing is said: colours of lines, wire frames, reflections."""
    vertices, faces = np.random.default_rng(1).normal(size=(5, 3)), np.array([[0, 1, 2], [2, 3, 4]])
    mesh = Shape("m", scene.bodies.names[1], "mesh", vertices=vertices, faces=faces, colour=(0.2, 0.4, 0.6, 0.5))
    shapes = (*scene.shapes, mesh)
    scene = dataclasses.replace(scene, shapes=shapes)
    assert {shape.kind for shape in (*shapes, *scene.decorations)} == {"box", "cylinder", "sphere", "mesh"}
    drawn = [command["object"] for command in map(umsgpack.unpackb, draw(scene)) if command["type"] == "set_object"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of modules that it imports
        from meshcat import geometry
    for shape, ours in zip((*shapes, *scene.decorations), drawn, strict=True):
        if shape.kind == "box":
            made = geometry.Box(list(shape.size))
        elif shape.kind == "sphere":
            made = geometry.Sphere(shape.size[0])
        elif shape.kind == "cylinder":
            made = geometry.Cylinder(shape.size[1], shape.size[0])
            made.radialSegments = 32
        else:
            made = geometry.TriangularMeshGeometry(shape.vertices.astype(np.float32), shape.faces.astype(np.uint32))
        paint = ours["materials"][0]
        kind = getattr(geometry, paint["type"])
        painted = kind(color=paint["color"], opacity=shape.colour[3], depthWrite=shape.colour[3] >= 1)
        theirs = umsgpack.unpackb(umsgpack.packb(geometry.Mesh(made, painted).lower()))
        assert ours["geometries"][0] | {"uuid": ""} == theirs["geometries"][0] | {"uuid": ""}
        shown = {key: theirs["materials"][0][key] for key in ("color", "side", "transparent", "opacity", "depthWrite")}
        assert shown.items() <= paint.items()
        assert ours["object"]["matrix"] == theirs["object"]["matrix"]
        assert ours["object"]["geometry"] == ours["geometries"][0]["uuid"]
        assert ours["object"]["material"] == paint["uuid"]


def test_cylinders_lie_along_their_z_axis(scene):
    placed = [command for command in map(umsgpack.unpackb, draw(scene)) if command["type"] == "set_transform"]
    number = next(k for k, shape in enumerate(scene.shapes) if shape.kind == "cylinder")
    (matrix,) = (command["matrix"] for command in placed if command["path"].endswith(f"/{number}"))
    T = np.reshape(matrix, (4, 4)).T
    np.testing.assert_allclose(T[:3, 1], scene.shapes[number].T_body_shape[:3, 2], atol=1e-15)  # meshcat's axis is y


def test_a_missing_mesh_warns_in_python(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(LOST_MESH)
    with pytest.warns(viz.PictureWarning, match="lost.stl"):
        page = viz.page(calib.load(path))
    assert "lost.stl" in scene_of(page)["notes"][0]


def test_the_noise_of_a_reading_and_of_a_mean_are_told_apart(scene):
    several = dataclasses.replace(scene.poses, readings=np.where(np.arange(len(scene.poses)) < 4, 4, 1))
    sigma = 8e-5 / np.sqrt(several.readings)
    result = certainty(dataclasses.replace(scene, poses=dataclasses.replace(several, sigma=sigma)))
    assert result["noise"] == pytest.approx(0.08)
    assert result["means"] == pytest.approx([0.04, 0.08])
    assert result["readings"] == [1, 4]
    assert result["predicted"] == pytest.approx([0.02 * np.sqrt(3)] * 2)


def test_unknown_noise_is_unknown(scene):
    unknown = np.full(len(scene.poses), np.nan)
    table = dataclasses.replace(scene.poses, sigma=unknown, spread=np.repeat(unknown[:, None], 3, axis=1))
    known = certainty(dataclasses.replace(scene, poses=table))
    assert [known[name] for name in ("noise", "means", "predicted")] == [None, None, None]


def test_many_points_are_drawn_smaller():
    assert point_pixels(100) == 7
    assert 4 <= point_pixels(5000) < point_pixels(1000) < 7


@pytest.mark.parametrize(("names", "places"), [(("0", "7", "15"), [0, 7, 15]), (("a", "b", "15"), [1, 2, 3])])
def test_images_are_drawn_at_their_numbers_and_others_in_order(names, places):
    scene = dataclasses.replace(camera_scenes.scene(3), names=names)
    pixels = np.zeros((len(scene.pixels), 2))
    result = SimpleNamespace(scene=scene, pixels=pixels, board=pixels, left_out=SimpleNamespace(pixels=pixels))
    by_image, *_ = _image_charts(result).by_place["images"]
    assert by_image.panels[0]["layers"][0]["x"] == places
