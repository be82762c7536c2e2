"""All data sets: a new one is a file here, and its name in this list."""

from . import (
    charuco_hand_eye,
    fr3_camera,
    klipper_delta,
    motoman_pixels,
    motoman_right,
    mukca,
    positioner,
    tilting_base,
    ur10_chessboard,
    ur10_tracker,
)

DATA_SETS = (
    ur10_tracker.DATA,
    motoman_right.DATA,
    motoman_pixels.DATA,
    mukca.PANDA,
    mukca.KUKA,
    fr3_camera.DATA,
    positioner.DATA,
    ur10_chessboard.DATA,
    tilting_base.DATA,
    charuco_hand_eye.DATA,
    klipper_delta.DATA,
)
