"""All data sets: a new one is an entry here, of a file of its own or beside others that are like it."""

from . import charuco_hand_eye, klipper_delta, motoman_pixels, mukca, tilting_base
from .serial_arms import CHESSBOARD, FRANKA, MOTOMAN, POSITIONER, UR10

DATA_SETS = (
    *(UR10, MOTOMAN, motoman_pixels.DATA, mukca.PANDA, mukca.KUKA, FRANKA, POSITIONER, CHESSBOARD, tilting_base.DATA),
    *(charuco_hand_eye.DATA, klipper_delta.DATA),
)
