"""A filter of one's own, a class in a file, in place of the navigation."""

from pathlib import Path

import hil

name = f"{Path(__file__).parents[1] / 'backends' / 'ekf.py'}:Ekf"
run = hil.run("scheme-1", navigation=name, duration_s=60.0)
print(run.summary["navigation"]["position_rmse_m"])
