"""Names in a calibration of Universal Robots (the YAML of `ur_calibration`, and `default_kinematics.yaml`).

Its key `kinematics` has six joint origins, from `base_link_inertia` on. `calib.fleets` makes a URDF of it,
`calib.exporting` writes it.
"""

from __future__ import annotations

LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
JOINTS = tuple(f"{name}_joint" for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"))
KEYS = ("x", "y", "z", "roll", "pitch", "yaw")
