"""Preflight of a tracker: it is reached, tracks its bodies, and streams at a rate."""

from __future__ import annotations

import time
from typing import Final

from hil.config.rig import Rig
from hil.core.clock import WallClock
from hil.errors import DeviceError
from hil.parts.tracker.link import open_link
from hil.parts.tracker.table import Tracker
from hil.preflight.check import PreflightCheck

_LISTENED_S: Final = 1.0
_NAME: Final = "device tracker"


def checks(rig: Rig) -> list[PreflightCheck]:
    """Return the check of the tracker of ``rig``."""
    config: Tracker = rig.table_of_part("tracker")
    if config.driver == "mock":
        return [PreflightCheck(_NAME, None, "in memory")]
    clock = WallClock()
    try:
        link = open_link(config, clock)
    except DeviceError as error:
        return [PreflightCheck(_NAME, False, str(error), "switch its streaming on; address and port: [tracker]")]
    try:
        time.sleep(_LISTENED_S)
        frames = link.poll(clock.now_s())
    finally:
        link.close()
    if not frames:
        return [PreflightCheck(_NAME, False, f"no frame within {_LISTENED_S:g} s", "switch its streaming on")]
    seen = {name for frame in frames for name in frame.bodies}
    missing = [f"{role} ({body.body})" for role, body in config.bodies.items() if body.body not in seen]
    rate = f"{len(frames) / _LISTENED_S:.0f} frames per second"
    if missing:
        shown = ", ".join(map(str, sorted(seen, key=str))) or "none"
        return [PreflightCheck(_NAME, False, f"{rate}, not tracked: {', '.join(missing)}", f"tracked are: {shown}")]
    return [PreflightCheck(_NAME, True, f"{rate}, tracked: {', '.join(config.bodies)}")]
