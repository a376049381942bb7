"""``hil emulate``: the emulated devices of a rig, or its cameras alone, without a loop."""

from __future__ import annotations

import signal
import threading
import time
from pathlib import Path

from rich.console import Console

from hil.cli.options import Settings
from hil.errors import BadInput

_CAMERAS = "cameras"
_CHECK_S = 0.2


def emulate(
    rig: str = "emulated",
    *,
    scenario: str = "scheme-1",
    folder: str | None = None,
    geometry_out: str | None = None,
    settings: Settings = (),
    speed: float = 1.0,
) -> int:
    """Start the emulated devices of a rig, print their addresses, and run until Ctrl-C.

    Parameters
    ----------
    rig
        emulated, or the path of a rig file; or cameras: only the GigE Vision cameras of the emulated rig.
    scenario
        Gives the noise of the emulated vision unit.
    folder
        Images of emulated cameras, left/NNNN.png and right/NNNN.png; default: the ring at the start of the scenario.
    geometry_out
        Write the geometry of emulated cameras and ring, for hil vmu and hil cameras aid.
    speed
        Simulation speed relative to real time.
    """
    if rig == _CAMERAS:
        return _emulate_cameras(scenario, folder, settings, geometry_out)
    for option, value in (("--folder", folder), ("--geometry-out", geometry_out)):
        if value is not None:
            raise BadInput.single(option, "", "goes with hil emulate cameras")
    return _emulate_rig(rig, scenario, settings, speed)


def _emulate_cameras(scenario: str, folder: str | None, settings: Settings, geometry_out: str | None) -> int:
    from hil.config.load import load_rig, load_scenario
    from hil.core.clock import WallClock
    from hil.core.files import write_text
    from hil.drivers.cameras.base import SIDES
    from hil.parts.cameras.pose_sensor import calibrated_geometry
    from hil.parts.emulation.cameras import emulated_camera
    from hil.parts.emulation.emulated_cameras import images_at_start, images_of_folder
    from hil.session.assembly import with_cameras

    loaded = load_scenario(scenario, settings)
    rig = with_cameras(loaded, load_rig("emulated", settings)).value
    images = images_of_folder(Path(folder), rig) if folder is not None else images_at_start(loaded.value, rig)
    clock, stop, console = WallClock(), threading.Event(), Console()
    cameras = [emulated_camera(rig.vmu, clock, image_at, side) for side, image_at in zip(SIDES, images, strict=True)]
    if geometry_out is not None:
        known = calibrated_geometry(rig)
        sides = {
            side: camera.model_copy(update={"identity": emulator.identity((camera.width, camera.height))})
            for side, camera, emulator in zip(SIDES, (known.left, known.right), cameras, strict=True)
        }
        write_text(known.model_copy(update=sides).model_dump_json(), geometry_out)
    threads = [threading.Thread(target=camera.run, args=(stop,), daemon=True) for camera in cameras]
    try:
        for camera, thread in zip(cameras, threads, strict=True):
            for name, address in camera.start().items():
                console.print(f"{name} on {address}", highlight=False)
            thread.start()
        console.print("Ctrl-C ends them")
        signal.pause()
    except KeyboardInterrupt:
        console.print("ended")
    finally:
        stop.set()
        for camera in cameras:
            camera.close()
    return 0


def _emulate_rig(rig: str, scenario: str, settings: Settings, speed: float) -> int:
    from hil.config.load import load_rig, load_scenario
    from hil.core.clock import WallClock
    from hil.parts.emulation.emulated_devices import EmulatedDevices

    loaded, loaded_rig = load_scenario(scenario, settings), load_rig(rig, settings)
    if loaded_rig.value.kind != "emulated":
        text = f'"{loaded_rig.value.kind}": only "emulated" has devices to emulate'
        raise BadInput.single(loaded_rig.source, "kind", text)
    console = Console()
    with EmulatedDevices(loaded.value, loaded_rig.value, WallClock(speed=speed), seed=0) as emulated:
        _, addresses = emulated.wait_ready()
        for name, address in addresses.items():
            pid = emulated.pids[emulated.process_of(name)]
            console.print(f"{name} on {address} (process {pid})", highlight=False)
        try:
            console.print("Ctrl-C ends them")
            reported: set[str] = set()
            while True:
                for name, text in emulated.ended().items():
                    if name not in reported:
                        console.print(f"{name} {text}", highlight=False)
                        reported.add(name)
                time.sleep(_CHECK_S)
        except KeyboardInterrupt:
            console.print("ended")
    return 0
