"""The bench paper's numerical simulation (IV.A): both readings of Table I, compared with Table II.

python sims/fusion_study.py [runs]
"""

from __future__ import annotations

import sys

from hil.monte_carlo.fusion import TABLE_II_SD, run_fusion

if __name__ == "__main__":
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    for reading in ("swapped", "printed"):
        found = run_fusion(reading, runs, 0, (), 1, lambda done: None)
        print(f"{reading}: rmse / bound {found['position_ratio']} {found['attitude_ratio']}")
        print(f"  position {found['position_rmse_m']} m, Table II {TABLE_II_SD[0]}")
        print(f"  attitude {found['attitude_rmse_deg']} deg, Table II {TABLE_II_SD[1]}")
        print(f"  NEES at 400 s: {found['nees_pkf']} {found['nees_akf']}")
