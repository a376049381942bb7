"""Emulated devices of a rig: the child processes' program, and the parent's hold on all of them.

``python -m hil.processes.emulators DEVICE`` is a child; it gets its configuration from its parent.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any, Literal, Self

from hil.cameras.factory import make_pose_sensor
from hil.cameras.pose_model import transport
from hil.config.driver_registry import DeviceTable
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.core.camera_images import ThreadedImageSink
from hil.core.clock import WallClock
from hil.core.messages import PoseFrame
from hil.core.realtime import take_fifo
from hil.drivers.emulator_process import Emulator, EmulatorProcess, serve
from hil.drivers.shared_state import SharedAxisState
from hil.frmn.image_memory import PictureMemory
from hil.setup.assembly import start_axes

_READY_WALL_S = 60.0  # the first start compiles
_FIFO_PRIORITY = 40  # below everything that the bench itself is run by


def devices(rig: Rig) -> tuple[str, ...]:
    """Return the names of the devices that ``rig`` has."""
    return ("rails", "turntable", "vmu", *(("io",) if rig.has_io else ()), *(("target",) if rig.moved_target else ()))


class EmulatedDevices:
    """Starts an emulator process for each device of ``rig`` and keeps them until ``close``.

    pictures: where a rendered vision unit puts its pictures; None: nowhere.
    """

    def __init__(
        self, scenario: Scenario, rig: Rig, clock: WallClock, seed: int, pictures: PictureMemory | None = None
    ) -> None:
        self.board = SharedAxisState.create()
        self._rig = rig
        configuration = {
            "scenario": scenario.model_dump(mode="json"),
            "rig": rig.model_dump(mode="json"),
            "epoch_ns": clock.epoch_ns,
            "speed": clock.speed,
            "seed": seed,
            "board": self.board.descriptor,
        }
        self.processes: list[EmulatorProcess] = []
        self._with_pictures: EmulatorProcess | None = None
        try:
            for device in devices(rig):
                program = [sys.executable, "-m", "hil.processes.emulators", device]
                shown = pictures if device == "vmu" else None
                told = {**configuration, "pictures": shown}
                descriptors = (self.board.descriptor, *(shown.descriptors if shown else ()))
                self.processes.append(EmulatorProcess(device, program, told, descriptors))
                if shown:
                    self._with_pictures = self.processes[-1]
        except BaseException:
            self.close()
            raise

    @property
    def pids(self) -> dict[str, int]:
        """The process of each device: stopping it is pulling the device's plug."""
        return {process.name: process.pid for process in self.processes}

    def wait_ready(self) -> tuple[Rig, dict[str, str]]:
        """Return the rig with the wires that the emulators opened, and where each one listens.

        Raises DeviceError when one does not come up.
        """
        addresses: dict[str, str] = {}
        for process in self.processes:
            addresses |= process.wait_ready(_READY_WALL_S)
        return _connected(self._rig, addresses), addresses

    def close(self) -> None:
        """End all of them, together and at once: an emulated device has nothing to bring to safety. Idempotent.

        A unit that has pictures on their way may hand them over before.
        """
        for process in self.processes:
            if process is self._with_pictures:
                process.close()
        for process in self.processes:
            process.kill()
        for process in self.processes:
            process.close()
        self.board.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _connected(rig: Rig, addresses: dict[str, str]) -> Rig:
    """Return ``rig`` with the emulators' addresses in place of its wires."""
    names = {"target_manipulator": "target"}
    tables = {key: table.connected(names.get(key, key), addresses) for key, table in rig.device_tables().items()}
    return rig.model_copy(update=tables)


def make_emulator(
    device: Literal["rails", "turntable", "vmu", "io", "target"], configuration: dict[str, Any]
) -> Emulator:
    """Return the emulator of ``device`` for the configuration that the parent sent."""
    scenario = Scenario.model_validate(configuration["scenario"], strict=False)
    rig = Rig.model_validate(configuration["rig"], strict=False)
    clock = WallClock(configuration["epoch_ns"], configuration["speed"])
    board = SharedAxisState(configuration["board"])
    seed = configuration["seed"]
    table: DeviceTable | None = getattr(rig, "target_manipulator" if device == "target" else device)
    assert table is not None
    emulator: Emulator
    if device == "io":
        emulator = table.make_emulator(clock, board.write_chain, seed=seed)
        return emulator
    if device != "vmu":
        emulator = table.make_emulator(clock, board, seed=seed, name=device)
        return emulator
    shown = _pictures(configuration["pictures"], rig)
    eye = make_pose_sensor(scenario, rig, seed, shown)
    rehearsed = make_pose_sensor(scenario, rig, seed)  # compiles, and leaves the noise of the other one alone
    start = start_axes(scenario, rig)
    for k in range(3):  # the search in whole pictures, then windows
        rehearsed.look(start.rail_m, start.gimbal_rad, k / rig.vmu.rate_hz)

    def pose_at(t_s: float) -> PoseFrame | None:
        rails, _ = board.read("rails", t_s)
        gimbals, _ = board.read("turntable", t_s)
        return eye.look(rails, gimbals, t_s)

    at_end = shown.close if shown else lambda: None
    emulator = table.make_emulator(clock, pose_at, transport(scenario.vmu, seed), seed=seed, at_end=at_end)
    return emulator


def _pictures(memory: Sequence[int] | None, rig: Rig) -> ThreadedImageSink | None:
    """Return what takes a rendered unit's pictures: in a thread of its own, for the unit keeps time."""
    maker = PictureMemory(*memory).maker(rig) if memory else None
    return ThreadedImageSink(maker) if maker else None


def _keep_time(device: str, speed: float) -> None:
    """Let emulated hardware keep time whatever else this computer does, as real hardware would.

    At more than the speed of time the emulators together can fill a core, which a real-time policy must not: then
    only the coupler has it, whose relay opens when it sleeps through 50 ms.
    """
    if speed <= 1.0 or device == "io":
        take_fifo(_FIFO_PRIORITY)


def _make(configuration: dict[str, Any]) -> Emulator:
    emulator = make_emulator(sys.argv[1], configuration)  # type: ignore[arg-type]
    _keep_time(sys.argv[1], configuration["speed"])
    return emulator


if __name__ == "__main__":
    serve(_make)
