"""Numbers of the bench paper that a run is laid beside."""

from __future__ import annotations

from dataclasses import dataclass

from hil.config.model import Triple


@dataclass(frozen=True)
class ReadyPhase:
    """Largest deviations in the ready phase (Table V), absolute values, and when it was reached."""

    position_m: Triple
    velocity_mps: Triple
    attitude_deg: Triple
    rate_degps: Triple
    ready_time_s: float | None


TABLE_V = {
    "scheme-1": ReadyPhase(
        (0.0053, 0.0081, 0.0070), (0.0121, 0.0100, 0.0127), (0.1945, 0.0618, 0.0455), (0.0250, 0.0660, 0.0245), 162.0
    ),
    "scheme-2": ReadyPhase(
        (0.0064, 0.0093, 0.0111), (0.0128, 0.0094, 0.0182), (0.1881, 0.0583, 0.0317), (0.0284, 0.0701, 0.0371), 326.0
    ),
    "scheme-3": ReadyPhase(
        (0.0081, 0.0334, 0.0392), (0.0169, 0.0245, 0.0258), (0.2821, 0.2787, 0.0838), (0.0667, 0.2227, 0.0684), None
    ),
}
