"""Identity of the devices, and check of the vision unit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from hil.config.rig import Rig
from hil.errors import LinkTimeout
from hil.loop.motion_sequences import MotionSequencer
from hil.loop.runner import Runner
from hil.parts.commissioning.prompt import OperatorPrompt

_FIRST_FRAME_S: Final = 5.0
_NUMBERS: Final = ("one", "two", "three", "four", "five", "six")


def expected_identity(rig: Rig) -> list[str]:
    """Return a line per controller of axes; all are open, and their drivers reject any other identity."""
    return [
        f"{name}: {_number_of_axes(len(part.axis_names))}, "
        f"{_as_required(part.entry.identity(part) if part.has_wires else {})}"
        for group, table in rig.axis_groups.items()
        for name, part in table.parts(group).items()
    ]


def check_vision_unit(runner: Runner, sequencer: MotionSequencer, rig: Rig, prompt: OperatorPrompt) -> None:
    """Open the vision unit while the axes are at rest, and wait for a pose; it is closed with the bench.

    Raises DeviceError; LinkTimeout if no pose arrives, with the number of frames without one.
    """
    if not rig.has_vmu:
        prompt.show("vmu: none")
        return
    source = runner.source
    source.open(runner.now_s())
    start_s = now_s = sequencer.begin().now_s
    while not (frames := source.poll(now_s)):
        if now_s - start_s > _FIRST_FRAME_S:
            seen = source.counters()["no_pose"]
            text = f"{seen} frames without a pose: is the target in view from here?"
            raise LinkTimeout(source.name, text if seen else f"no frame within {_FIRST_FRAME_S:g} s")
        now_s = sequencer.tick().now_s
    required = rig.vmu.identity.model_dump(exclude_none=True)
    distance_m = float(np.linalg.norm(frames[-1].t_v))
    prompt.show(f"vmu: {_as_required(required)}, target measured at {distance_m:.3f} m")


def _number_of_axes(n: int) -> str:
    return f"{_NUMBERS[n - 1]} {'axis' if n == 1 else 'axes'}"


def _as_required(required: Mapping[str, str]) -> str:
    if not required:
        return "responds; the rig file requires no identity"
    return f"{', '.join(f'{name} {value}' for name, value in required.items())}: as expected"
