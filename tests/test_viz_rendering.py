"""The robot's picture: what is drawn where, which side is in front, and how the light falls."""

import base64
import dataclasses
import io

import numpy as np
import pytest
from PIL import Image
from viz_examples import medrue_robot

from viz.inputs import gather
from viz.rendering import HEIGHT, WIDTH, picture_of
from viz.shapes import mesh, primitive


def drawn(scene):
    """The picture as numbers (height, width, 4)."""
    head, _, data = picture_of(scene).partition(",")
    assert head == "data:image/png;base64"
    with Image.open(io.BytesIO(base64.b64decode(data))) as image:
        assert image.size == (WIDTH, HEIGHT)
        return np.asarray(image.convert("RGBA")).astype(int)


@pytest.fixture(scope="module")
def scene():
    return gather(medrue_robot()).scene


def posed(scene, *shapes, direction=(1.0, 0.0, 0.0)):
    """Shapes on the first link alone, seen from a direction of the upright frame."""
    view = dataclasses.replace(scene.view, direction=np.array(direction))
    return dataclasses.replace(scene, shapes=shapes, view=view)


def at(scene, point):
    """Pose of a shape at a point of the upright frame, (4, 4), on the first link of the robot at home."""
    pose = np.eye(4)
    pose[:3, :3] = scene.view.upright.T
    pose[:3, 3] = scene.view.upright.T @ np.asarray(point, dtype=float)
    return np.linalg.inv(scene.bodies.matrices(scene.solid, 0)[0]) @ pose


def test_a_square_covers_the_part_of_the_picture_that_it_should(scene):
    link = scene.bodies.names[0]
    picture = drawn(posed(scene, primitive("a", link, "box", (0.1, 1.0, 1.0), at(scene, (0, 0, 0)))))
    side = HEIGHT * 0.92  # a margin of four per cent at each end of the shorter side
    assert np.sum(picture[..., 3] == 255) == pytest.approx(side**2, rel=0.01)
    assert picture[5, 5, 3] == 0


@pytest.mark.parametrize(("front", "seen"), [(0.5, 0), (-0.5, 2)])
def test_what_is_nearer_hides_what_is_behind(scene, front, seen):
    link = scene.bodies.names[0]
    red = primitive("a", link, "box", (0.1, 1.0, 1.0), at(scene, (front, 0, 0)), (1.0, 0.0, 0.0, 1.0))
    blue = primitive("b", link, "box", (0.1, 1.0, 1.0), at(scene, (0, 0, 0)), (0.0, 0.0, 1.0, 1.0))
    middle = drawn(posed(scene, red, blue))[HEIGHT // 2, WIDTH // 2]
    assert middle[seen] > 100
    assert middle[2 - seen] == 0


def test_a_face_is_seen_from_both_sides_and_brighter_towards_the_light(scene):
    link = scene.bodies.names[0]
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    for faces in ([[0, 1, 2], [0, 2, 3]], [[2, 1, 0], [3, 2, 0]]):
        plate = mesh("a", link, corners, np.array(faces), (0.5, 0.5, 0.5, 1.0), at(scene, (0, 0, 0)))
        assert drawn(posed(scene, plate, direction=(0.001, 0.0, 1.0)))[HEIGHT // 2, WIDTH // 2, 3] == 255
    box = primitive("b", link, "box", (1.0, 1.0, 1.0), at(scene, (0, 0, 0)), (0.5, 0.5, 0.5, 1.0))
    picture = drawn(posed(scene, box, direction=(0.7, 0.1, 0.7)))
    column = picture[:, WIDTH // 2]
    known = column[column[:, 3] == 255, 0]
    assert known[5] > known[-5] + 20  # the top is in the light


def test_the_same_scene_gives_the_same_picture_and_a_robot_fits_in(scene):
    assert picture_of(scene) == picture_of(scene)
    cover = drawn(scene)[..., 3]
    assert not np.any(cover[[0, -1]])
    assert not np.any(cover[:, [0, -1]])
    assert 0.02 < np.mean(cover > 0) < 0.6
