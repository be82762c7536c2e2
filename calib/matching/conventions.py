"""Manufacturers' forms of rotations, and the words of their headers, for reading files and for messages."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import scipy

from calib.core.base.arrays import FloatArray


@dataclass(frozen=True)
class Convention:
    """A form of rotations.

    Attributes:
        form: Its name; three axes in scipy's notation (capitals: moving axes).
        width: Numbers of a rotation.
        makers: Manufacturers that use it.
    """

    form: str
    width: int = 3
    makers: str = ""

    @property
    def has_angles(self) -> bool:
        """Whether the numbers of a rotation are angles, which have a unit."""
        return self.width == 3

    def rotation(self, numbers: FloatArray) -> scipy.spatial.transform.Rotation:
        """Return the rotations of numbers (n, width), angles in rad."""
        of = scipy.spatial.transform.Rotation
        if self.form == "rotation vector":
            return of.from_rotvec(numbers.copy())
        if self.form == "matrix":
            return of.from_matrix(numbers.reshape(-1, 3, 3))
        if self.width == 4:
            return of.from_quat(numbers, scalar_first=self.form.startswith("qw"))
        return of.from_euler(self.form, numbers)

    def __str__(self) -> str:
        axes = f"angles about {'moving' if self.form.isupper() else 'fixed'} axes" if len(self.form) == 3 else ""
        description = ", ".join(filter(None, (axes, self.makers)))
        return f"{self.form} ({description})" if description else self.form


_SEQUENCES = sorted({a + b + c for a, b in permutations("XYZ", 2) for c in "XYZ" if c != b})
_MAKERS = {"xyz": "FANUC's W P R, roll pitch yaw", "ZYX": "KUKA's A B C", "XYZ": "Stäubli's rx ry rz", "ZYZ": "O A T"}
CONVENTIONS = (
    Convention("rotation vector", makers="UR's rx ry rz"),
    *(Convention(axes, makers=_MAKERS.get(axes, "")) for axes in (*_SEQUENCES, *map(str.lower, _SEQUENCES))),
    Convention("qx qy qz qw", 4),
    Convention("qw qx qy qz", 4),
    Convention("matrix", 9),
)
HEADERS = {
    "qx qy qz qw": "qx qy qz qw",
    "q1 q2 q3 q4": "qw qx qy qz",
    "w p r": "xyz",
    "a b c": "ZYX",
    "o a t": "ZYZ",
    "roll pitch yaw": "xyz",
    "alpha beta gamma": "XYZ",
    "rx ry rz": "",
    "thetax thetay thetaz": "xyz",
    " ".join(f"r{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3)): "matrix",
}
"""Endings of column names, and the form that they mean; rx ry rz are ambiguous."""
