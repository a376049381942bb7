"""Vision process: solves the images of the cameras that it starts, and hands the poses on through shared memory.

``python -m hil.parts.vision.process`` is started by ``CamerasVmu``. It has a real-time priority as long as a pair
takes a few milliseconds; searches, which can fill a core, have none.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from hil.config.rig import Vmu
from hil.core.child_process import Parent
from hil.core.clock import WallClock
from hil.core.messages import VMU_FRAME
from hil.core.plug_ins import call, plug_in_error
from hil.core.realtime import drop_priority, limit_fifo, take_fifo
from hil.drivers.remote import io_layout
from hil.drivers.remote.server import FIFO_PRIORITY
from hil.drivers.vmu import NAME
from hil.errors import BadInput, BenchError, DeviceError
from hil.parts.cameras.live import LiveVision, middle_row_s, sized_cameras
from hil.parts.cameras.pose_sensor import estimator_of_unit, geometry_of_unit
from hil.parts.vision.cameras import HEARTBEAT_S, attach

_WAIT_WALL_S: Final = 0.01
_FIFO_CPU_S: Final = 0.03  # a pair takes 5 ms, a search of both images without false lights 15 ms


def main() -> None:
    """Serve until the parent ends; a failure is reported in shared memory, one at the start by the ready message."""
    parent = Parent()
    drop_priority()
    configuration = parent.configuration
    block, ring = attach(configuration["descriptors"])
    vmu = Vmu.model_validate(configuration["vmu"], strict=False)
    clock = WallClock(configuration["epoch_ns"], configuration["speed"])
    geometry = geometry_of_unit(vmu)
    try:
        vision = call(NAME, LiveVision, estimator_of_unit(vmu), vmu, middle_row_s(geometry))
        cameras, doubt = sized_cameras(vmu, geometry, clock)
    except BadInput as error:
        parent.send(failure=["DeviceError", NAME, str(error)])
        return
    except DeviceError as error:
        parent.send(failure=[type(error).__name__, error.device, error.what])
        return
    record = np.zeros(1, VMU_FRAME)
    counted_s = -1.0
    limit_fifo(_FIFO_CPU_S)
    parent.send(pids=cameras.pids)
    try:
        while not parent.wait_end(0.0):
            take_fifo(FIFO_PRIORITY - 10)
            before_s = clock.now_s()  # frames that arrive while this process waits for the processor are not late
            for side, frame in cameras.frames(_WAIT_WALL_S):
                vision.put(side, frame)
            cameras.check(before_s)
            for pose in vision.poses(clock):
                now_s = clock.now_s()
                replace(pose, received_s=now_s).write_to(record)
                ring.put(record)
                vision.sent(now_s)
            now_s = clock.now_s()
            if now_s - counted_s > HEARTBEAT_S:
                counted_s = now_s
                counters = vision.counters() | {"skipped": cameras.skipped, "identity_proven": int(not doubt)}
                counters["clock_jumps"] += sum(cameras.jumps)
                block["counters"].write(io_layout.counters_record(counters), now_s)
    except (Exception, SystemExit) as error:
        known = error if isinstance(error, BenchError) else plug_in_error(NAME, error)
        block["failure"].write(io_layout.failure_record(known, NAME), clock.now_s())
        parent.wait_end(60.0)
    finally:
        cameras.close()


if __name__ == "__main__":
    main()
