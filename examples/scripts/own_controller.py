"""A controller of one's own, a class in a file, against the built-in one."""

from pathlib import Path

import hil

law = f"{Path(__file__).parents[1] / 'backends' / 'controller.py'}:DeadBand"
for control in ("builtin", law):
    run = hil.run("scheme-1", control=control, duration_s=60.0)
    print(control.rpartition(":")[2], run.accepted, run.summary["thrusters"]["propellant_kg"])
