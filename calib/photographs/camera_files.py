"""Intrinsics from camera files: YAML of OpenCV's calibration, and `camera_info` of ROS.

    OpenCV    camera_matrix (`!!opencv-matrix`: rows, cols, data), distortion_coefficients, image_width, image_height
    ROS       the same keys without the tag, and distortion_model
    calib     fx, fy, cx, cy, k1, k2, p1, p2, k3, and image: [width, height]

Other models are refused by name: fish-eye (equidistant), and rational, thin prism or tilted terms beyond k3 unless they
are zero.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import DescriptionError, nearest
from calib.core.base.files import read_text
from calib.core.base.sections import parse_yaml
from calib.core.instruments.camera import NAMES

_FISHEYE = ("equidistant", "fisheye", "kannala_brandt", "kannala-brandt", "omni", "mei", "double_sphere")
_PLAIN = ("plumb_bob", "rational_polynomial", "radtan", "none", "pinhole", "brown_conrady")
_WANTED = "intrinsics (YAML of OpenCV, or camera_info of ROS)"


@dataclass(frozen=True, eq=False)
class CameraFile:
    """Intrinsics fx fy cx cy k1 k2 p1 p2 k3 from a file [px and numbers], (9,), and the image size [px], or None."""

    intrinsics: FloatArray
    image: tuple[int, int] | None


def read_camera(path: Path | str) -> CameraFile:
    """Return the camera of a file.

    Raises:
        DescriptionError: The file cannot be read, has no camera matrix, or has an unknown camera model.
    """
    text = read_text(path, _WANTED, DescriptionError)
    text = re.sub(r"\A%YAML[: ].*\n(---\s*\n)?", "", text)  # OpenCV writes `%YAML:1.0`, which YAML does not know
    content = parse_yaml(text, path)
    if not isinstance(content, dict):
        raise DescriptionError(f"{path}: holds no {_WANTED}")
    _check_model(content, path)
    inner = content.get("intrinsics")
    named = inner if isinstance(inner, dict) else content
    intrinsics = np.array([*_pinhole(content, named, path), *_distortion(content, named, path)])
    if not (intrinsics[0] > 0 and intrinsics[1] > 0 and np.all(np.isfinite(intrinsics))):
        raise DescriptionError(f"{path}: focal lengths must be positive, and all intrinsics finite")
    return CameraFile(intrinsics, _size(content, path))


def _check_model(content: Mapping[str, Any], path: Path | str) -> None:
    model = str(content.get("distortion_model") or content.get("camera_model") or "").casefold()
    if model in _FISHEYE or any(str(key).casefold().startswith("fisheye") and content[key] for key in content):
        raise DescriptionError(
            f"{path}: is of a fish-eye camera ({model or 'fisheye'}), but only the pinhole model with"
            " k1 k2 p1 p2 k3 is known here; undistort the images first, and give the intrinsics of those"
        )
    if model and model not in _PLAIN:
        raise DescriptionError(f"{path}: distortion_model '{model}' is not known here{nearest(model, _PLAIN)}")


def _numbers(value: Any, path: Path | str, key: str) -> list[float]:
    data = value.get("data") if isinstance(value, dict) else value
    flat = np.ravel(np.array(data, dtype=object)) if isinstance(data, (list, tuple)) else np.zeros(0)
    try:
        return [float(number) for number in flat]
    except (OverflowError, TypeError, ValueError):
        raise DescriptionError(f"{path}: {key}: holds something that is not a number") from None


def _first(content: Mapping[str, Any], *keys: str) -> tuple[str, Any]:
    return next(((key, content[key]) for key in keys if content.get(key) is not None), ("", None))


def _pinhole(content: Mapping[str, Any], named: Mapping[str, Any], path: Path | str) -> list[float]:
    if all(key in named for key in NAMES[:4]):
        return _numbers([named[key] for key in NAMES[:4]], path, "fx, fy, cx, cy")
    key, matrix = _first(content, "camera_matrix", "Camera_Matrix", "cameraMatrix", "K", "k", "camera_matrix_left")
    if matrix is None:
        raise DescriptionError(f"{path}: has no camera_matrix, and no fx, fy, cx, cy; give {_WANTED}")
    numbers = _numbers(matrix, path, key)
    if len(numbers) != 9:
        raise DescriptionError(f"{path}: {key}: has {len(numbers)} numbers; a camera matrix has 9")
    if abs(numbers[1]) > 1e-6 * abs(numbers[0]):
        raise DescriptionError(f"{path}: {key}: has a skew of {numbers[1]:g}, which is not known here")
    if [numbers[3], *numbers[6:]] != [0, 0, 0, 1]:
        raise DescriptionError(f"{path}: {key}: is not [fx, 0, cx, 0, fy, cy, 0, 0, 1]; transpose it if it is MATLAB's")
    return [numbers[0], numbers[4], numbers[2], numbers[5]]


def _distortion(content: Mapping[str, Any], named: Mapping[str, Any], path: Path | str) -> list[float]:
    if any(key in named and not isinstance(named[key], (list, dict)) for key in NAMES[4:]):
        return _numbers([named.get(key, 0.0) for key in NAMES[4:]], path, "k1, k2, p1, p2, k3")
    key, given = _first(
        content, "distortion_coefficients", "Distortion_Coefficients", "distortionCoefficients", "dist_coeffs", "D", "d"
    )
    numbers = [] if given is None else _numbers(given, path, key)
    if any(abs(number) > 0 for number in numbers[5:]):
        raise DescriptionError(
            f"{path}: {key}: has {len(numbers)} coefficients; k4 and beyond (rational, thin prism, tilted) are not"
            " known here: calibrate the camera with k1 k2 p1 p2 k3, or let them be found (leave the file out)"
        )
    return (numbers + [0.0] * 5)[:5]


def _size(content: Mapping[str, Any], path: Path | str) -> tuple[int, int] | None:
    image = content.get("image")
    pairs = [(content.get(f"{of}width"), content.get(f"{of}height")) for of in ("image_", "")]
    pairs += [tuple(image)] if isinstance(image, list) and len(image) == 2 else []
    pairs += [(image.get("width"), image.get("height"))] if isinstance(image, dict) else []
    for width, height in pairs:
        if width is not None and height is not None:
            try:
                return int(width), int(height)
            except (OverflowError, TypeError, ValueError):
                raise DescriptionError(f"{path}: width and height of the image are not numbers") from None
    return None
