"""Field of view: every lamp of the ring in both images throughout, at the pose that the bench really had."""

from __future__ import annotations

from typing import Any

import numpy as np

from hil.bench.field_of_view import view_margins
from hil.config.rig import Rig
from hil.params import gnc as gnc_params


def judge_field_of_view(history: np.ndarray, rig: Rig, step_s: float) -> dict[str, Any]:
    """Return ``passed``, the least margin to an image's edge, px, when and at which range it was, and the time lost."""
    if not len(history):
        return {"passed": False, "margin_px": None, "at_s": None, "range_m": None, "lost_s": None}
    camera, leds = gnc_params.camera(rig)
    margins = np.empty(len(history))
    feedback = history["feedback"]
    view_margins(
        gnc_params.bench(rig, step_s),
        gnc_params.stations(rig),
        camera,
        leds,
        np.ascontiguousarray(feedback["rail_m"]),
        np.ascontiguousarray(feedback["gimbal_rad"]),
        margins,
    )
    worst = int(np.argmin(margins))
    least = float(margins[worst])
    return {
        "passed": bool(least >= 0.0),
        "margin_px": least if np.isfinite(least) else None,
        "at_s": float(history["t_s"][worst]),
        "range_m": float(np.linalg.norm(history["truth"]["r_CT_H"][worst])),
        "lost_s": float(step_s * np.count_nonzero(margins < 0.0)),
    }
