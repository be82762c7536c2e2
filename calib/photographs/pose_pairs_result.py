"""A hand-eye calibration from pairs of poses in words and as data."""

from __future__ import annotations

import numpy as np

from calib.photographs.hand_eye_result import FEW, WIDE, Frames, HandEyeJudgement, contents, transform
from calib.photographs.pose_pairs import FoundPose, PosePairs
from calib.photographs.scene import SIDES

_MM = 1e3
_NAMES = ("x", "y", "z", "rx", "ry", "rz")


def judge_pairs(result: PosePairs) -> HandEyeJudgement:
    """Return the judgement of a calibration: FAIL if the camera's pose is not determined or poses are misread."""
    reasons, advice = [*result.reasons], []
    for name, found in (("camera", result.camera), ("marker", result.marker)):
        lost = [_NAMES[k] for k in np.flatnonzero(found.open)]
        known = found.half[~found.open] / np.repeat([result.distance, 1.0], 3)[~found.open]
        if lost:
            grade = "FAIL" if name == "camera" else "CHECK"
            reasons.append(
                (grade, f"{', '.join(lost)} of the {name} {'is' if len(lost) == 1 else 'are'} not determined")
            )
            advice.append(
                "turn the tool about two axes or more; or measure by hand what is not determined, such as a height"
            )
        if not np.all(known < WIDE):
            reasons.append(("CHECK", f"the place of the {name} is poorly known: see its intervals"))
            advice.append("turn the tool further, about two axes or more, at more poses")
    if len(result.names) < FEW:
        reasons.append(("CHECK", f"{len(result.names)} pairs are few to judge by"))
        advice.append(f"take {FEW} to 20 pairs")
    return HandEyeJudgement.from_reasons(reasons, advice)


def report_pairs(result: PosePairs, frames: Frames) -> str:
    """Return the report of a calibration in words."""
    judgement, above = judge_pairs(result), frames.parents(result.mount)
    off = [_MM * np.sqrt(np.mean(np.sum(result.errors[:, part] ** 2, axis=1))) for part in (slice(3), slice(3, 6))]
    lines = [
        f"Hand-eye calibration of {len(result.names)} pairs of poses: camera {SIDES[result.mount]}",
        *judgement.lines(),
        f"Residuals of the marker in the camera: {off[0]:.3f} mm and {off[1]:.3f} mrad RMS",
        _pose_in_words(f"Camera in {above[0]}", result.camera),
        _pose_in_words(f"Marker in {above[1]}", result.marker),
    ]
    lines += [
        f"These pairs cannot show a common change of {change}; measure one of them by hand" for change in result.unseen
    ]
    return "\n".join([*lines, *(f"Next: {text}" for text in judgement.advice)])


def _pose_in_words(title: str, found: FoundPose) -> str:
    parts = []
    pose = transform(found.pose)
    for k, name in enumerate("xyz"):
        text = f"{_MM * pose[name]:.3f} ± {_MM * found.half[k]:.3f} mm"
        parts.append(f"{name} {'not determined' if found.open[k] else text}")
    about = [name for name, lost in zip("xyz", found.open[3:], strict=True) if lost]
    if about:
        return f"{title}: {', '.join(parts)}; its rotation about its {', '.join(about)} is not determined (95 %)"
    quaternion = " ".join(f"{pose[key]:.6f}" for key in ("qx", "qy", "qz", "qw"))
    halves = ", ".join(f"± {half:.3f}" for half in np.rad2deg(found.half[3:]))
    return f"{title}: {', '.join(parts)}, quaternion (x y z w) {quaternion}, {halves} deg about its x, y, z (95 %)"


def content_of_pairs(result: PosePairs, frames: Frames) -> dict[str, object]:
    """Return a calibration as data [m, rad]; undetermined values are null."""
    above = frames.parents(result.mount)
    return {
        **judge_pairs(result).content(),
        "contains": contents(result.contains),
        "camera_on": result.mount,
        "camera": _as_data(above[0], frames.camera, result.camera),
        "board": _as_data(above[1], frames.board, result.marker),
        "not_determined": list(result.unseen),
        "pairs": [
            {"name": name, "position_m": error[:3].tolist(), "rotation_rad": error[3:].tolist()}
            for name, error in zip(result.names, result.errors, strict=True)
        ],
    }


def _as_data(parent: str, child: str, found: FoundPose) -> dict[str, object]:
    pose: dict[str, object] = dict(transform(found.pose))
    pose |= {name: None for name, lost in zip("xyz", found.open[:3], strict=True) if lost}
    if np.any(found.open[3:]):
        pose |= dict.fromkeys(("qx", "qy", "qz", "qw"))
    halves = [None if lost else float(half) for half, lost in zip(found.half, found.open, strict=True)]
    whole = {} if np.any(found.open) else {"matrix": found.pose.tolist()}
    return {"parent": parent, "child": child, **pose, **whole, "half_widths95": dict(zip(_NAMES, halves, strict=True))}
