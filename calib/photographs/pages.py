"""Pages with photographs: the detected points in each, and the errors of a calibration as arrows.

A page is one file: it holds small copies of the images, with SVG drawn over them.
"""

from __future__ import annotations

import base64
from html import escape

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.photographs.detection import DetectedImage
from calib.photographs.opencv import GreyImage, encode, opencv

_WIDTH = 480  # px of the small copies


def small_copy(image: GreyImage | str) -> bytes:
    """Return a small copy of an image as JPEG; empty if there is only the reason why it is missing."""
    if isinstance(image, str):
        return b""
    height, width = image.shape
    if width > _WIDTH:
        cv2 = opencv()
        size = _WIDTH, max(round(height * (_WIDTH / width)), 1)
        return encode(cv2.resize(image, size, interpolation=cv2.INTER_AREA), ".jpg")
    return encode(image, ".jpg")


def figure(
    image: DetectedImage, small: bytes, caption: str, arrows: FloatArray | None = None, *, is_outlying: bool = False
) -> str:
    """Return a photograph, a small copy as JPEG if there is one, with its detected points as HTML.

    Arrows lead from the detected points to others, such as predicted points, (n, 2) [px].
    """
    (width, height), name = image.size, escape(image.name)
    words = f'<b>{name}</b>: <span class="{"off" if is_outlying else "fine"}">{escape(caption)}</span>'
    if not small or not width:
        return f"<figure><figcaption>{words}</figcaption></figure>"
    radius = max(width, height) / 100
    address = f"data:image/jpeg;base64,{base64.b64encode(small).decode()}"
    marks = "".join(f'<circle cx="{u:.1f}" cy="{v:.1f}" r="{radius:.1f}"/>' for u, v in image.pixels)
    lines = (
        ""
        if arrows is None
        else "".join(
            f'<line x1="{u:.1f}" y1="{v:.1f}" x2="{x:.1f}" y2="{y:.1f}"/>'
            for (u, v), (x, y) in zip(image.pixels, arrows, strict=True)
        )
    )
    first = ""
    if len(image.pixels):
        u, v = image.pixels[0]
        where = f'x="{u:.1f}" y="{v - 2 * radius:.1f}" font-size="{4 * radius:.1f}"'
        first = f'<text {where} fill="#e0007a">{escape(image.points[0])}</text>'
    return (
        f'<figure><svg viewBox="0 0 {width} {height}" role="img" aria-label="{name}">'
        f'<image href="{address}" width="{width}" height="{height}"/>'
        f'<g fill="none" stroke="#00a2ff" stroke-width="{radius / 2.5:.2f}">{marks}</g>'
        f'<g stroke="#e0007a" stroke-width="{radius / 2:.2f}">{lines}</g>{first}</svg>'
        f"<figcaption>{words}</figcaption></figure>"
    )


def exaggeration(errors: FloatArray, width: int) -> float:
    """Return a round factor that makes errors (n, 2) [px] visible in an image of `width` [px]."""
    typical = float(np.sqrt(np.mean(np.sum(errors**2, axis=1)))) if len(errors) else 0.0
    if typical <= 0:
        return 1.0
    most = max(0.05 * width / typical, 1.0)
    power = 10 ** np.floor(np.log10(most))
    return float(power * max(step for step in (1, 2, 5) if step * power <= most))
