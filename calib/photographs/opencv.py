"""OpenCV (the extra `camera`): it finds boards in images, places single boards, and reads and writes image files."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.core.base.errors import DataError, DescriptionError, InputError, nearest, require_package
from calib.core.base.files import read_bytes
from calib.core.base.version import DISTRIBUTION

GreyImage = NDArray[np.uint8]
"""Grey values, (height, width)."""


def opencv() -> Any:
    """Return the module `cv2`.

    Raises:
        InputError: OpenCV is not installed, or too old.
    """
    missing = "OpenCV, which finds boards in images and places them, is not installed: pip install"
    cv2 = require_package("cv2", f"{missing} opencv-python-headless (or {DISTRIBUTION}[camera])")
    if tuple(map(int, cv2.__version__.split(".")[:2])) < (4, 14) or not hasattr(cv2, "aruco"):
        raise InputError(
            f"OpenCV {cv2.__version__} is too old (it finds corners of ChArUco boards half a pixel off): pip install"
            " 'opencv-python-headless>=4.14'"
        )
    return cv2


@contextmanager
def one_thread() -> Iterator[None]:
    """Compute in one thread of OpenCV: several add in another order each time, and so round differently."""
    cv2 = opencv()
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)


def dictionary(name: str) -> Any:
    """Return a dictionary of markers.

    Raises:
        DescriptionError: There is no dictionary of this name.
    """
    aruco = opencv().aruco
    names = dictionaries()
    known = {original.casefold(): original for original in names}
    if name.casefold() not in known:
        raise DescriptionError(f"no dictionary '{name}'{nearest(name, names)}")
    return aruco.getPredefinedDictionary(getattr(aruco, known[name.casefold()]))


def dictionaries() -> list[str]:
    """Return the names of all dictionaries."""
    aruco = opencv().aruco
    named = {getattr(aruco, name): name for name in sorted(dir(aruco)) if name.startswith("DICT_")}
    return sorted(named.values())


def dictionary_families() -> dict[str, list[str]]:
    """Return the endings of dictionaries, such as _50, _100, smallest first, by the common beginning of their names."""
    families: dict[str, list[str]] = {}
    for name in dictionaries():
        family, _, size = name.rpartition("_")
        whole = not size.isdigit() or "X" not in family
        families.setdefault(name if whole else family, []).append("" if whole else f"_{size}")
    return {family: sorted(sizes, key=lambda size: int(size[1:] or 0)) for family, sizes in families.items()}


def read_image(path: Path | str) -> GreyImage:
    """Return an image file as grey values.

    Raises:
        DataError: No such file, or no image that can be read.
    """
    return decode(read_bytes(path, "an image", DataError), str(path))


def decode(content: bytes, where: str) -> GreyImage:
    """Return the content of an image file as grey values.

    Colours are turned into grey by one formula here, since image decoders use different formulas.

    Raises:
        DataError: It is not a readable image.
    """
    if content.startswith(b"\x89PNG") and b"IEND" not in content:
        raise DataError(f"{where}: is cut off: its end is missing; copy it again")
    cv2 = opencv()
    level = cv2.utils.logging.setLogLevel(0) if hasattr(cv2.utils, "logging") else None
    try:
        image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED) if content else None
    except cv2.error:
        image = None
    finally:
        if level is not None:
            cv2.utils.logging.setLogLevel(level)
    if image is None or image.ndim not in (2, 3):
        raise DataError(f"{where}: is not an image that can be read; give PNG, JPEG, TIFF or BMP")
    if image.dtype not in (np.uint8, np.uint16):
        raise DataError(f"{where}: has pixels of type {image.dtype}; give an image with 8 or 16 bits")
    return to_grey(image)


def to_grey(image: NDArray[Any]) -> GreyImage:
    """Return an image of 8 or 16 bits as grey values: (height, width), or with one, three (BGR) or four channels."""
    cv2 = opencv()
    if image.dtype != np.uint8:
        image = (image / max(int(image.max()) / 255.0, 1.0)).astype(np.uint8)
    if image.ndim == 2 or image.shape[2] == 1:
        return np.ascontiguousarray(image.reshape(image.shape[:2]))
    return np.ascontiguousarray(cv2.cvtColor(np.ascontiguousarray(image[:, :, :3]), cv2.COLOR_BGR2GRAY))


def encode(image: GreyImage, suffix: str = ".png") -> bytes:
    """Return an image as the content of a file of this kind.

    Raises:
        InputError: OpenCV cannot write such files.
    """
    cv2 = opencv()
    options = [cv2.IMWRITE_JPEG_QUALITY, 80] if suffix == ".jpg" else []
    done, content = cv2.imencode(suffix, image, options)
    if not done:
        raise InputError(f"OpenCV cannot write images as {suffix}")
    return bytes(content)
