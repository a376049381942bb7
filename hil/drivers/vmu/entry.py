"""Registry entries of the vision unit: on RS-422, and computed on this host from cameras."""

from __future__ import annotations

from typing import Final

from hil.config.load import load_frame
from hil.config.rig import Vmu, VmuDatagrams, VmuLine
from hil.config.tables.cameras import VisionCameras
from hil.config.tables.driver_registry import DriverEntry, WireKey
from hil.errors import BadInput

_BITS_PER_BYTE: Final = 10


def frames_of(vmu: Vmu) -> str:
    """Return the name or path of the frame file of a unit on a serial line or on UDP."""
    frames: str = vmu.settings.frames if vmu.driver == DATAGRAMS.name else (vmu.rs422 or VmuLine()).frames
    return frames


def _check_files(vmu: Vmu) -> list[str]:
    frame = load_frame(frames_of(vmu))
    if frame.value.identity_sync is None and any(text is not None for text in vmu.identity.model_dump().values()):
        raise BadInput.single("rig", "vmu.identity", f'frames "{frame.value.name}" have no identity: omit the table')
    return frame.value.warnings()


def _frames_hz(vmu: Vmu) -> float:
    """The unit sends one frame after the other."""
    from hil.drivers.vmu.codecs import frame_codec  # on use: it is large

    line = vmu.rs422 or VmuLine()
    return line.baud / (_BITS_PER_BYTE * frame_codec(line.frames).size)


ENTRY: Final = DriverEntry(
    "vmu",
    "rs422",
    driver="hil.drivers.vmu.driver:Rs422Vmu",
    emulator="hil.parts.emulation.vision_unit:VmuEmulator",
    wires=[WireKey("rs422.port", "serial")],
    check_files=_check_files,
    identity=lambda vmu: vmu.identity.model_dump(exclude_none=True),
    setpoints_hz=_frames_hz,
    keeps_bench_time=lambda table: True,
)

DATAGRAMS: Final = DriverEntry(
    "vmu",
    "udp",
    driver="hil.drivers.vmu.driver:UdpVmu",
    emulator="hil.parts.emulation.vision_unit:UdpVmuEmulator",
    settings=VmuDatagrams,
    wires=[WireKey("udp", "udp")],
    check_files=_check_files,
    identity=lambda vmu: vmu.identity.model_dump(exclude_none=True),
    keeps_bench_time=lambda table: True,
)

CAMERAS: Final = DriverEntry(
    "vmu",
    "cameras",
    driver="hil.parts.vision.cameras:CamerasVmu",
    emulator="hil.parts.emulation.cameras:emulated_camera",
    settings=VisionCameras,
    wires=[WireKey(f"cameras.{side}", "camera", side) for side in ("left", "right")],
    has_processes=True,
    emulated_parts=("left", "right"),
)
"""GenICam or V4L2 cameras; their images are solved on this host."""
