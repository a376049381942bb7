"""What the devices of a rig must say they are, and whether the vision unit is there."""

from __future__ import annotations

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
    low = rig.rails.map.firmware_min
    rails = f"rails: three drives, vendor 0x{rig.rails.map.vendor:X}, firmware {low[0]}.{low[1]} or newer: as expected"
    return [rails, f"turntable: three axes, {_turntable(rig)}"]


def _turntable(rig: Rig) -> str:
    asked: dict[str, str] = {}
    if rig.turntable.driver == "cia402" and (can := rig.turntable.cia402) is not None:
        numbers = {"vendor": can.vendor_id, "product": can.product_code, "revision from": can.revision_min}
        asked = {name: f"0x{value:X}" for name, value in numbers.items() if value is not None}
        asked |= {"firmware": can.firmware} if can.firmware is not None else {}
    elif rig.turntable.driver == "ascii" and rig.turntable.ascii is not None:
        asked = {str(name): value for name, value in rig.turntable.ascii.identity.items()}
    return _as_asked(asked)


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
    asked = rig.vmu.identity.model_dump(exclude_none=True)
    distance_m = float(np.linalg.norm(frames[-1].t_v))
    dialogue.tell(f"vmu: {_as_asked(asked)}, sees the target at {distance_m:.3f} m")


def _as_asked(asked: dict[str, str]) -> str:
    if not asked:
        return "answers; the rig file asks for no identity"
    return f"{', '.join(f'{name} {value}' for name, value in asked.items())}: as expected"
