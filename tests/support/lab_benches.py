"""Rig files of benches with fewer axes than six, or with rails that are not parallel to H."""

from __future__ import annotations

from pathlib import Path
from typing import Final

TWO_RAILS: Final = """
[rails.z]
fixed_m = -0.35
"""
RAILS_AND_YAW: Final = """
[turntable.roll]
fixed_deg = 0.0

[turntable.pitch]
fixed_deg = 0.0
"""
TABLE_OF_ONE_AXIS: Final = """
[rails]
driver = "none"
x = { fixed_m = 5.0 }
y = { fixed_m = -0.3 }
z = { fixed_m = -0.05 }

[turntable.roll]
fixed_deg = 3.0

[turntable.pitch]
fixed_deg = 3.0
"""
TARGET_ON_ONE_AXIS: Final = """
[rotary_manipulator.roll]
fixed_deg = 0.0

[rotary_manipulator.pitch]
fixed_deg = 0.0
"""
TURNED_RAILS: Final = """
[bench]
lab_axes = [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
bodies = []

[rails.x]
travel_m = [-1.5, 1.5]
park_m = 0.0

[rails.y]
travel_m = [-12.0, 0.2]
park_m = -3.0

[turntable.yaw]
travel_deg = [-150.0, -30.0]
park_deg = -90.0
home_deg = -90.0
"""
PLANE: Final = """
[bench]
lever_arm_m = [0.0, 0.0, 0.0]
lab_axes = [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]
bodies = []

[rails.z]
fixed_m = 0.0

[turntable.roll]
fixed_deg = -90.0

[turntable.pitch]
fixed_deg = 0.0
"""
BENCHES: Final = {
    "two rails": TWO_RAILS,
    "three rails and yaw": RAILS_AND_YAW,
    "table of one axis": TABLE_OF_ONE_AXIS,
    "turned rails": TURNED_RAILS,
    "plane": PLANE,
    "target on one axis": TARGET_ON_ONE_AXIS,
    "two rails, target on one axis": TWO_RAILS + RAILS_AND_YAW + TARGET_ON_ONE_AXIS,
}


def rig_file(folder: Path, bench: str, kind: str = "mock") -> str:
    """Return the path of a rig file of ``bench`` in ``folder`` that extends the shipped rig of ``kind``."""
    base = f"{kind}-manipulator" if "target" in bench else kind
    path = folder / "lab.toml"
    path.write_text(f'extends = "{base}"\nname = "lab"\n{BENCHES[bench]}', encoding="utf-8")
    return str(path)
