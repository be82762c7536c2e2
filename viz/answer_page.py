"""A page with one result: an acceptance by new measurements, a hand-eye calibration, or a board in photographs."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

import numpy as np

from calib.core.base.units import ERROR_UNIT, in_unit, millimetres, quantity_text
from calib.core.judging.acceptance import Acceptance
from calib.photographs.detection import Detection
from calib.photographs.hand_eye import HandEye
from viz.charts import COLOURS, Chart, Charts, PageRows, axis, layer, panel
from viz.page_parts import places
from viz.report_page import command_line, printed_page
from viz.result_charts import forest
from viz.viewer_page import ViewerPage

_SHOWN = 24  # changes
_GRADES = {"agrees": "PASS", "unlike poses": "CHECK", "too few readings": "CHECK"}  # of new readings; others: FAIL


def answer_page(
    subject: object, title: str, text: str, figures: Sequence[tuple[int, str]], *, created: datetime | None = None
) -> ViewerPage:
    """Return the page of an `Acceptance`, a `HandEye` or a `Detection`, with the text of the terminal.

    Figures are HTML, each with the index of its image (-1: none). `created` is printed; default: now.

    Raises:
        TypeError: `subject` is of another type.
    """
    if isinstance(subject, HandEye):
        charts = _image_charts(subject)
        grade = next((line.split()[-1] for line in text.splitlines() if line.startswith("Verdict:")), "CHECK")
    elif isinstance(subject, Detection):
        charts, grade = Charts({}), ""
    elif isinstance(subject, Acceptance):
        charts, grade = _new_reading_charts(subject), _GRADES.get(subject.verdict, "FAIL")
    else:
        raise TypeError(f"no page of {type(subject).__name__}")
    first, *rest = [part for part in text.replace("\n  ", " ").splitlines() if part.strip()]
    split = next((k for k, line in enumerate(rest) if line.startswith(("Smallest", "Changes", "ISO 9283"))), len(rest))
    return printed_page(
        "answer.html",
        charts,
        command_line(),
        created,
        title=title,
        grade=grade,
        first=first,
        lines=rest[:split],
        table="\n".join(rest[split:]),
        figures=figures,
    )


def _image_charts(result: HandEye) -> Charts:
    """Errors of each image and each point, and the comparison of used and left-out images."""
    scene = result.scene
    used, left, board = (scene.rms_by_image(v) for v in (result.pixels, result.left_out.pixels, result.board))
    texts = tuple(
        f"image {name}: {u:.2f} px RMS used, {o:.2f} px left out, {quantity_text(b, 'mm', '.3f')} on the board"
        for name, u, o, b in zip(scene.names, used, left, board, strict=True)
    )
    images = np.arange(len(scene))
    numbers = [float(name) for name in scene.names] if all(map(str.isdecimal, scene.names)) else images + 1.0
    rows = PageRows(texts, tuple(images.tolist()), ("circle",) * len(images))
    by_image = panel(
        axis("image"),
        axis("error [px RMS]"),
        [
            layer("points", "used", COLOURS["after"], x=numbers, y=used, rows=images),
            layer("points", "left out in turn", COLOURS["x"], x=numbers, y=left, rows=images),
        ],
    )
    points = layer("points", "", COLOURS["after"], x=result.pixels[:, 0], y=result.pixels[:, 1], rows=scene.image)
    cloud = panel(axis("across [px]"), axis("down [px]"), [points], equal=True)
    positions = panel(
        axis("x of the tool [mm]"),
        axis("y of the tool [mm]"),
        [
            layer(
                "points", "", COLOURS["after"], x=millimetres(scene.tool[:, 0, 3]), y=millimetres(scene.tool[:, 1, 3]),
                rows=images,
            )
        ],
        equal=True,
    )  # fmt: skip
    plots = (
        Chart("images", "Error of each image", "An image far above the others is off.", (by_image,), 500),
        Chart("pixels", "Predicted minus found", "A cloud around zero is noise; a shift or a tail is not.", (cloud,)),
        Chart("tool", "Where images were taken", "Seen from above; the more spread, the better.", (positions,)),
    )
    return Charts(places(images=plots), rows)


def _new_reading_charts(acceptance: Acceptance) -> Charts:
    errors, part = acceptance.errors, acceptance.errors.main_part
    unit, sizes, names = ERROR_UNIT[part.dimension], [], []
    for instrument, its_part, columns in errors.parts():
        if its_part.name == part.name:
            sizes.append(np.linalg.norm(errors.after[instrument.name][:, columns], axis=1))
            names += [errors.data.names[visit] for visit in errors.data.readings[instrument.name].visits]
    size = in_unit(np.concatenate(sizes), unit)
    numbers = {name: k for k, name in enumerate(dict.fromkeys(names))}
    rows = PageRows(
        tuple(f"pose {name}: {part.name} error {value:.3g} {unit}" for name, value in zip(names, size, strict=True)),
        tuple(numbers[name] for name in names),
        ("circle",) * len(names),
    )
    every = np.arange(len(size))
    layers = [layer("points", "", COLOURS["after"], x=every + 1.0, y=size, rows=every)]
    if part.is_position and np.isfinite(acceptance.expected_rms):
        expected = [millimetres(acceptance.expected_rms)] * 2
        layers.append(layer("line", "expected RMS", COLOURS["x"], x=[1.0, float(len(size))], y=expected))
    readings = panel(axis("reading"), axis(f"error [{unit}]"), layers)
    changes = acceptance.changes[:_SHOWN]
    texts = [f"{change.name}: {change.z:+.1f} standard deviations" for change in changes]
    z = np.array([change.z for change in changes])
    reach = np.full(len(z), acceptance.coverage_factor)
    drawn = forest([change.name for change in changes], [("", COLOURS["after"], z, reach, texts)], "change [std]")
    plots = (
        Chart("readings", "Errors of the new readings", "Predicted minus read.", (readings,), 500),
        Chart("changes", "Which change explains them", "Each alone, with its 95 % interval.", drawn, 440),
    )
    return Charts(places(readings=plots), rows)
