"""What the devices of a rig must say they are, and whether the vision unit is there."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from hil.commission.prompt import OperatorPrompt
from hil.config.rig import Rig
from hil.errors import LinkTimeout
from hil.loop.motion_sequences import MotionSequencer
from hil.loop.runner import Runner

_FIRST_FRAME_S: Final = 5.0


def expected_identity(rig: Rig) -> list[str]:
    """Return a line for rails and turntable, which have been opened: their drivers refuse any other identity."""
    return [
        f"{key}: three axes, {_as_required(table.entry.identity(table) if table.has_wires else {})}"
        for key, table in (("rails", rig.rails), ("turntable", rig.turntable))
    ]


def see_vision_unit(runner: Runner, sequencer: MotionSequencer, rig: Rig, dialogue: OperatorPrompt) -> None:
    """Open the vision unit beside axes that stand, and wait for a frame; it is closed with the bench.

    Raises DeviceError; LinkTimeout where no frame comes.
    """
    source = runner.source
    source.open(runner.now_s())
    begun_s = now_s = sequencer.begin().now_s
    while not (frames := source.poll(now_s)):
        if now_s - begun_s > _FIRST_FRAME_S:
            raise LinkTimeout(source.name, f"no pose within {_FIRST_FRAME_S:g} s")
        now_s = sequencer.tick().now_s
    required = rig.vmu.identity.model_dump(exclude_none=True)
    distance_m = float(np.linalg.norm(frames[-1].t_v))
    dialogue.tell(f"vmu: {_as_required(required)}, sees the target at {distance_m:.3f} m")


def _as_required(required: Mapping[str, str]) -> str:
    if not required:
        return "answers; the rig file asks for no identity"
    return f"{', '.join(f'{name} {value}' for name, value in required.items())}: as expected"
