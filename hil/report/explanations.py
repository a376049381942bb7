"""Explanations of the lines of a verdict, as ``hil run --explain`` prints them."""

from __future__ import annotations

from typing import Final

EXPLANATIONS: Final = {
    "control precision": "Deviations of the truth from the ready state, from the ready time to the end, each axis "
    "alone. Margin: 1 - deviation / tolerance of Table III.",
    "security": "Least margins of the truth to the corridor of the approach and to the allowed closing rate.",
    "energy": "Propellant against a multiple of what the plan costs in impulses. No sequence of impulses through the "
    "same states needs less than the impulsive bound.",
    "field of view": "Least distance of an LED from the edge of an image; negative: outside.",
    "integrity": "With each estimate the GNC states a protection level, which bounds its error. Misleading: the error "
    "is beyond an alert limit, the level below it, and no alarm. Available: fraction of the cycles with a level below "
    "its alert limit.",
    "decision": "Docking go by the estimate, checked against the truth. NEES not too large: the mean error squared "
    "over its covariance is no larger than in a filter whose sigmas are right; a budget makes it smaller.",
    "Ready": "First time at which each row of Table III has held for the dwell time.",
    "Navigation": "Root mean square of the error from 100 s on. Bound: Cramér-Rao bound, the least error of any filter "
    "with these sensors over the spread of the error budget: a run with smaller errors may be below it. It is a "
    "reference, not a requirement: an error above it fails no part.",
    "Sensor": "Samples by what the navigation made of them. Mean NIS: 1 per component if noise is as stated.",
    "Thrusters": "Time with a demand on x, y, z, before allocation; firings: openings of all valves.",
    "Bench": "Pose of the camera by the encoders against the truth: the error that rails and turntable add.",
    "Emulated": "The same by the true axes, which no encoder shows.",
    "Latency": "Percentiles: 50 % and 99 % of the values are below p50 and p99.",
    "Timing": "Overruns: cycles that ended after the next one was due. Lateness: start of a cycle after its time.",
    "Host": "Rights of real time that the system has granted to this process.",
    "Clocks": "Synchronisation of the clocks that stamp poses and cycles.",
    "Cameras": "Check of the cameras against their calibration before the run.",
}
"""Begin of a line -> what it means."""


def explanation_of(line: str) -> str:
    """Return the explanation of a line of the verdict, without markup, "" if it has none."""
    text = line.removeprefix("ok  ").removeprefix("fail").strip()
    return next((meaning for name, meaning in EXPLANATIONS.items() if text.startswith(name)), "")
