"""Shared memory between the loop, the I/O process and the watchdog process, and the layout of its records.

The loop writes setpoints, outputs and its heartbeat; the I/O process and the watchdog process write feedback, pose
frames, inputs, counters, errors and their own heartbeats. No process waits for another.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from typing import Final

import numpy as np

from hil.core import plug_ins
from hil.core.messages import MAX_THRUSTERS, VMU_FRAME, AxisFeedback, Homing, IoInputs, IoOutputs
from hil.errors import (
    BenchError,
    DeviceError,
    DriveFault,
    FaultKind,
    LinkLost,
    LinkTimeout,
    PlugInError,
    ProtocolError,
)
from hil.frmn.mailbox import MailboxBlock
from hil.frmn.ring import Ring

AXIS_DEVICES: Final = ("rails", "turntable", "target")
LOOP, IO, WATCHDOG = "loop", "I/O", "watchdog"
"""The processes; mailboxes of their heartbeats."""


def setpoint_record(n: int) -> np.dtype:
    """Return the record of a setpoint of ``n`` axes.

    rate_max, acceleration_max: limits within which the axes catch up after a gap.
    """
    return np.dtype(
        [(name, "f8", (n,)) for name in ("position", "rate", "rate_max", "acceleration_max")] + [("kind", "i8")]
    )


def feedback_record(n: int) -> np.dtype:
    """Return the record of the feedback of ``n`` axes."""
    fields = (("position", "f8"), ("rate", "f8"), ("homing", "i8"), ("limit", "i8"))
    return np.dtype([("t_s", "f8")] + [(name, kind, (n,)) for name, kind in fields])


CYCLIC, JOGGED, GOAL = 0, 1, 2
"""Kinds of setpoints: of homed axes within their travel; of axes that are jogged; the position to park at."""
HEARTBEAT: Final = np.dtype([("watched", "i8"), ("pause_s", "f8")])
"""pause_s: of the sender, by the host, within the last second, s of wall time; that of the loop is not sent."""
STOP: Final = np.dtype([("number", "i8"), ("kind", "i8")])
QUICK_STOP, DISABLE = 1, 2
"""Kinds of stops: braking along the ramp, and removal of the torque."""
FAILURE: Final = np.dtype([("kind", "S24"), ("device", "S64"), ("what", "S512"), ("fault", "S16")])
"""fault: value of the FaultKind of a DriveFault."""
COUNTERS: Final = np.dtype([("text", "S1024")])
CALLS: Final = np.dtype([("text", "S256")])
"""Calls of plug-ins under way in IO or WATCHDOG, as ``hil.core.plug_ins`` notes them."""
INPUTS: Final = np.dtype(
    [
        ("t_s", "f8"),
        ("estop_closed", "i8"),
        ("chain_closed", "i8"),
        ("interlocks", "S512"),
        ("thrusters_s", "f8"),
        ("brakes_closed", "i8"),  # -1: not read back
        ("local_enable", "i8"),  # -1: the bench has none
    ]
)
OUTPUTS: Final = np.dtype(
    [
        ("enable", "i8"),
        ("count", "i8"),
        ("thrusters", "u1", MAX_THRUSTERS),
        ("brakes_released", "i8"),
        ("pump", "i8"),
        ("warning", "i8"),
    ]
)
_FRAMES: Final = 256
_KINDS: Final[dict[str, type[DeviceError]]] = {
    kind.__name__: kind for kind in (LinkLost, LinkTimeout, ProtocolError, PlugInError)
}


def layout(held: Mapping[str, int] = {}) -> dict[str, np.dtype]:
    """Return the mailboxes. held: groups of further axes of the rig, by names: how many axes each has."""
    axes = dict.fromkeys(AXIS_DEVICES, 3) | {**held}
    devices = (*axes, "vmu", "io")
    return {
        LOOP: HEARTBEAT,
        IO: HEARTBEAT,
        WATCHDOG: HEARTBEAT,
        **{f"{name}.calls": CALLS for name in (IO, WATCHDOG)},
        **{f"{device}.setpoint": setpoint_record(n) for device, n in axes.items()},
        **{f"{device}.feedback": feedback_record(n) for device, n in axes.items()},
        **{f"{device}.stop": STOP for device in (*axes, "io")},
        "io.inputs": INPUTS,
        "io.outputs": OUTPUTS,
        **{f"{device}.failure": FAILURE for device in devices},
        **{f"{device}.counters": COUNTERS for device in devices},
    }


class IoSharedMemory:
    """The shared memory, in each process. wakes: descriptors of the eventfds that wake IO and WATCHDOG."""

    def __init__(self, block: MailboxBlock, frames: Ring, wakes: dict[str, int]) -> None:
        self.block = block
        self.frames = frames
        self.wakes = wakes

    @classmethod
    def create(cls, held: Mapping[str, int] = {}) -> IoSharedMemory:
        """Create new memory; pass ``descriptors`` to the other processes (``pass_fds``). held: see ``layout``."""
        wakes = {name: os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC) for name in (IO, WATCHDOG)}
        return cls(MailboxBlock.create(layout(held), "io"), Ring.create(VMU_FRAME, _FRAMES, "poses"), wakes)

    @classmethod
    def attach(cls, descriptors: tuple[int, int, int, int], held: Mapping[str, int] = {}) -> IoSharedMemory:
        """Attach to the memory that another process created."""
        block, frames, io, watchdog = descriptors
        wakes = {IO: io, WATCHDOG: watchdog}
        return cls(MailboxBlock(block, layout(held), "io"), Ring(frames, VMU_FRAME, _FRAMES, "poses"), wakes)

    @property
    def descriptors(self) -> tuple[int, int, int, int]:
        return self.block.descriptor, self.frames.descriptor, self.wakes[IO], self.wakes[WATCHDOG]

    def note_calls(self, name: str) -> None:
        """Keep the calls of plug-ins under way in this process, ``name``, where the loop can read them."""
        calls = self.block[f"{name}.calls"]
        plug_ins.note_calls(lambda text: calls.write(np.array([(text.encode()[:256],)], CALLS), 0.0))

    def calls_of(self, name: str) -> list[str]:
        """Return the calls under way in the process ``name``, as ``hil.core.plug_ins.note_calls`` has them."""
        record = np.zeros(1, CALLS)
        self.block[f"{name}.calls"].read(record)
        return [text for text in str(record["text"][0].decode(errors="replace")).split("; ") if text]

    def close(self) -> None:
        """Release the memory; idempotent."""
        while self.wakes:
            os.close(self.wakes.popitem()[1])
        self.block.close()
        self.frames.close()


def write_feedback(record: np.ndarray, feedback: AxisFeedback) -> None:
    """Put ``feedback`` into ``record``, shape (1,) of ``feedback_record``."""
    for name in ("t_s", "position", "rate", "homing", "limit"):
        record[name][0] = getattr(feedback, name)


def read_feedback(record: np.ndarray) -> AxisFeedback:
    """Return the feedback in ``record``, shape (1,) of ``feedback_record``; its arrays are copies."""
    t_s, position, rate, homing, limit = record[0].item()
    del position, rate
    return AxisFeedback(
        t_s,
        record["position"][0].copy(),
        record["rate"][0].copy(),
        tuple(map(Homing, homing)),
        tuple(map(int, limit)),
    )


def inputs_record(inputs: IoInputs) -> np.ndarray:
    """Return inputs as INPUTS, shape (1,)."""
    record = np.zeros(1, INPUTS)
    names = "\n".join(inputs.open_interlocks).encode()
    optional = [-1 if level is None else int(level) for level in (inputs.brakes_closed, inputs.local_enable)]
    record[0] = (inputs.t_s, inputs.estop_closed, inputs.chain_closed, names, inputs.thrusters_s, *optional)
    return record


def read_inputs(record: np.ndarray) -> IoInputs:
    """Return the inputs in ``record``, shape (1,) of INPUTS."""
    t_s, estop_closed, chain_closed, names, thrusters_s, *levels = record[0].item()
    interlocks = tuple(names.decode().split("\n")) if names else ()
    optional = (None if level < 0 else bool(level) for level in levels)
    return IoInputs(t_s, bool(estop_closed), bool(chain_closed), interlocks, thrusters_s, *optional)


def outputs_record(outputs: IoOutputs) -> np.ndarray:
    """Return outputs as OUTPUTS, shape (1,)."""
    record = np.zeros(1, OUTPUTS)
    lines = outputs.thrusters
    record["enable"], record["count"] = outputs.enable, len(lines)
    record["thrusters"][0, : len(lines)] = np.frombuffer(lines, np.uint8)
    for name in ("brakes_released", "pump", "warning"):
        record[name] = getattr(outputs, name)
    return record


def read_outputs(record: np.ndarray) -> IoOutputs:
    """Return the outputs in ``record``, shape (1,) of OUTPUTS."""
    lines = record["thrusters"][0].tobytes()[: int(record["count"][0])]
    levels = (bool(record[name][0]) for name in ("brakes_released", "pump", "warning"))
    return IoOutputs(bool(record["enable"][0]), lines, *levels)


def failure_record(error: BenchError, device: str) -> np.ndarray:
    """Return ``error`` as FAILURE, shape (1,); any other error than a DeviceError becomes one of ``device``."""
    record = np.zeros(1, FAILURE)
    if isinstance(error, DeviceError):
        fault = error.kind.value.encode() if isinstance(error, DriveFault) else b""
        record[0] = (type(error).__name__.encode(), error.device.encode(), error.what.encode()[:512], fault)
    else:
        record[0] = (b"DeviceError", device.encode(), str(error).encode()[:512], b"")
    return record


def failure_of(record: np.ndarray) -> DeviceError:
    """Return the error in ``record``, shape (1,) of FAILURE."""
    kind, device, what, fault = (field.decode(errors="replace") for field in record[0])
    if kind == DriveFault.__name__:
        return DriveFault(device, what, FaultKind(fault))
    return _KINDS.get(kind, DeviceError)(device, what)


def counters_record(counters: dict[str, int]) -> np.ndarray:
    """Return counters as COUNTERS, shape (1,)."""
    record = np.zeros(1, COUNTERS)
    record["text"] = json.dumps(counters, separators=(",", ":")).encode()[:1024]
    return record


def counters_of(record: np.ndarray) -> dict[str, int]:
    """Return the counters in ``record``, shape (1,) of COUNTERS."""
    counted: dict[str, int] = json.loads(record["text"][0] or b"{}")
    return counted
