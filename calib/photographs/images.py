"""Sources of images: files, folders, patterns such as `shots/*.png`, and ROS 2 bags with joint values.

An image that cannot be read is no error here: its `Shot` has the reason in words. A bag has many images of one stop of
the robot, which share its error; so only the middle image of each stop is used.
"""

from __future__ import annotations

import glob
import logging
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray
from calib.core.base.errors import DataError, InputError
from calib.core.base.registry import load_entry
from calib.core.base.words import count_noun, listing
from calib.core.data.other_formats import is_bag
from calib.photographs.opencv import GreyImage, decode, read_image, to_grey

SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm", ".webp")
_LOG = logging.getLogger("calib")
_RAW = "sensor_msgs/msg/Image"
_COMPRESSED = "sensor_msgs/msg/CompressedImage"
_CHANNELS = {"mono8": 1, "8UC1": 1, "rgb8": 3, "bgr8": 3, "8UC3": 3, "rgba8": 4, "bgra8": 4, "mono16": 1, "16UC1": 1}


@dataclass(frozen=True)
class Shot:
    """An image, read or still to be read.

    Attributes:
        name: Name in results: the file's name without suffix, or the number in a bag.
        path: The image file, or the bag.
        image: The image, or the reason why there is none; None before reading.
        joints: Joint values at that moment [m or rad]; None if unknown.
    """

    name: str
    path: str
    image: GreyImage | str | None = None
    joints: dict[str, float] | None = None

    def read(self) -> GreyImage | str:
        """Return the image, or the reason why there is none."""
        if self.image is not None:
            return self.image
        try:
            return read_image(self.path)
        except DataError as error:
            return str(error).removeprefix(f"{self.path}: ")


def shots(sources: Sequence[str], topic: str | None = None) -> list[Shot]:
    """Return the images of files, folders, patterns and bags, in the order of their names.

    A topic is required for a bag with images of several.

    Raises:
        InputError: No images, or two images of one name.
        DataError: A bag cannot be read.
    """
    result: list[Shot] = []
    for source in sources:
        if is_bag(source):
            result += _read_bag_images(source, topic)
            continue
        result += [Shot(Path(file).stem, file) for file in _files(source)]
    seen: dict[str, str] = {}
    for shot in result:
        if shot.name in seen:
            raise InputError(
                f"{shot.path} and {seen[shot.name]}: both are called '{shot.name}'; give images names of their own"
            )
        seen[shot.name] = shot.path
    return result


def _files(source: str) -> list[str]:
    path = Path(source)
    if path.is_dir():
        files = [str(file) for file in path.iterdir() if file.suffix.lower() in SUFFIXES and file.is_file()]
        if not files:
            raise InputError(f"{source}: has no images ({', '.join(SUFFIXES)})")
    elif path.exists():
        return [source]
    else:
        files = [file for file in glob.glob(source, recursive=True) if Path(file).is_file()]  # noqa: PTH207 (any folder)
        if not files:
            raise InputError(
                f"{source}: no such image, folder or bag; give files, a folder or a pattern such as 'shots/*.png'"
            )

    def with_numbers(file: str) -> list[object]:  # 2 comes before 10
        return [(0, int(part), "") if part.isdigit() else (1, 0, part) for part in re.split(r"(\d+)", Path(file).name)]

    return sorted(files, key=with_numbers)


def _read_bag_images(source: str, topic: str | None) -> Iterator[Shot]:
    """The middle image of each stop of the robot; all images of a bag without joint states."""
    kinds, bags = (_RAW, _COMPRESSED), load_entry("calib.methods", "bags")
    recorded = [(name, stamp) for name, _, stamp, _ in bags.messages_of_bag(source, kinds)]
    topics = sorted({name for name, _ in recorded})
    if not topics:
        raise DataError(f"{source}: has no images ({_RAW} or CompressedImage); record their topic too")
    if topic is None and len(topics) > 1:
        raise InputError(f"{source}: has images of several topics ({', '.join(topics)}); choose one with --topic")
    of_camera = topics[0] if topic is None else topic
    if of_camera not in topics:
        raise InputError(f"{source}: has no images of the topic {of_camera}; it has {', '.join(topics)}")
    stamps = np.array([stamp for name, stamp in recorded if name == of_camera])
    names, values, still = bags.joints_of_bag(source, stamps)
    chosen = set(_one_of_each_stop(source, values, still) if names else range(len(stamps)))
    if not names:
        _LOG.warning("%s: has no joint states (sensor_msgs/JointState), so its images have no joint values", source)
    images = (recording for recording in bags.messages_of_bag(source, kinds) if recording[0] == of_camera)
    for k, (_, kind, _, message) in enumerate(images):
        if k in chosen:
            joints = dict(zip(names, map(float, values[k]), strict=True)) if names else None
            image = _image_of(kind, message, f"{source}, image {k + 1}")
            yield Shot(f"{Path(source).stem}_{k + 1}", source, image, joints)


def _one_of_each_stop(source: str, values: FloatArray, still: BoolArray) -> list[int]:
    """Indices of the images to use; the others are logged in one line."""
    if not np.any(still):
        raise DataError(
            f"{source}: the robot did not stand still at any of {count_noun(len(still), 'image')}, or joint states"
            " before and after the image are missing"
        )
    moved, standing = np.flatnonzero(~still), np.flatnonzero(still)
    stop = load_entry("calib.methods", "bags").stops(values[standing])
    chosen = [int(of_stop[len(of_stop) // 2]) for of_stop in np.split(standing, np.flatnonzero(np.diff(stop)) + 1)]
    left = []
    if len(moved):
        numbers = listing([str(k + 1) for k in moved])
        left.append(f"the robot moved, or had no joint states, at {len(moved)} ({numbers})")
    if len(chosen) < len(standing):
        left.append(f"{len(standing) - len(chosen)} show the same stop as another")
    if left:
        _LOG.warning("%s: %d of %d images left out: %s", source, len(still) - len(chosen), len(still), "; ".join(left))
    return chosen


def _image_of(kind: str, message: Any, where: str) -> GreyImage | str:
    try:
        if kind == _COMPRESSED:
            return decode(bytes(message.data), where)
        return _raw_image(message)
    except (DataError, ValueError) as error:
        return str(error).removeprefix(f"{where}: ")


def _raw_image(message: Any) -> GreyImage:
    encoding = str(message.encoding)
    if encoding not in _CHANNELS:
        raise DataError(f"pixels are coded as {encoding}; record mono8, rgb8 or bgr8")
    deep = encoding.endswith("16") or encoding.startswith("16")
    kind: np.dtype[Any] = np.dtype(np.uint16 if deep else np.uint8).newbyteorder(">" if message.is_bigendian else "<")
    rows = np.frombuffer(bytes(message.data), np.uint8).reshape(message.height, message.step)
    channels = _CHANNELS[encoding]
    used = np.ascontiguousarray(rows[:, : message.width * channels * kind.itemsize]).view(kind)
    image = used.reshape(message.height, message.width, channels)
    return to_grey(image[:, :, 2::-1] if encoding.startswith("rgb") else image)  # to blue, green, red


def with_joints(photographs: Sequence[Shot]) -> list[Shot]:
    """Return images that all have joint values, or all have none; others are replaced by the reason, in words.

    Raises:
        DataError: Bags of different robots.
    """
    first = next((shot for shot in photographs if shot.joints), None)
    if first is None:
        return list(photographs)
    for shot in photographs:
        if shot.joints and set(shot.joints) != set(first.joints or ()):
            raise DataError(
                f"{shot.path}: has the joints {listing(list(shot.joints))}, and {first.path} has"
                f" {listing(list(first.joints or ()))}; give bags of one robot"
            )
    words = f"has no joint values, unlike images of {first.path}; give one of the two alone"
    return [shot if shot.joints else replace(shot, image=words) for shot in photographs]


def joint_columns(photographs: Sequence[Shot], chosen: Sequence[str]) -> tuple[list[str], FloatArray]:
    """Return names and values (n_chosen, n_joints) of the chosen images' joints; no names if images have none."""
    joints = {shot.name: shot.joints or {} for shot in photographs}
    names = list(joints[chosen[0]])
    return names, np.array([[joints[image][name] for name in names] for image in chosen])
