"""``hil emulate``: the emulated devices of a rig, without a loop."""

from __future__ import annotations

import signal

from rich.console import Console

from hil.cli.options import Settings
from hil.errors import BadInput


def emulate(rig: str = "emulated", *, scenario: str = "scheme-1", settings: Settings = (), speed: float = 1.0) -> int:
    """Start the emulated devices of a rig, print their addresses, and run until Ctrl-C.

    Parameters
    ----------
    rig
        emulated, or the path of a rig file.
    scenario
        Gives the noise of the emulated vision unit.
    speed
        Simulation speed relative to real time.
    """
    from hil.config.load import load_rig, load_scenario
    from hil.core.clock import WallClock
    from hil.drivers.emulated_devices import EmulatedDevices

    loaded, loaded_rig = load_scenario(scenario, settings), load_rig(rig, settings)
    if loaded_rig.value.kind != "emulated":
        text = f'"{loaded_rig.value.kind}": only "emulated" has devices to emulate'
        raise BadInput.single(loaded_rig.source, "kind", text)
    console = Console()
    with EmulatedDevices(loaded.value, loaded_rig.value, WallClock(speed=speed), seed=0) as emulated:
        _, addresses = emulated.wait_ready()
        for name, address in addresses.items():
            pid = emulated.pids[name.split(".")[0]]
            console.print(f"{name} on {address} (process {pid})", highlight=False)
        try:
            console.print("Ctrl-C ends them")
            signal.pause()
        except KeyboardInterrupt:
            console.print("ended")
    return 0
