"""``hil emulate``: the emulated devices of a rig, alone."""

from __future__ import annotations

import signal
from collections.abc import Sequence

from rich.console import Console

from hil.config.load import load_rig, load_scenario
from hil.core.clock import WallClock
from hil.errors import BadInput


def emulate_command(rig_name: str, scenario_name: str, settings: Sequence[str], speed: float) -> int:
    """Start them, say where they listen, stay until Ctrl-C."""
    from hil.processes.emulators import EmulatedDevices

    scenario, rig = load_scenario(scenario_name, settings), load_rig(rig_name, settings)
    if rig.value.kind != "emulated":
        raise BadInput.single(rig.source, "kind", f'"{rig.value.kind}": only "emulated" has devices to emulate')
    console = Console()
    with EmulatedDevices(scenario.value, rig.value, WallClock(speed=speed), seed=0) as emulated:
        _, addresses = emulated.wait_ready()
        for process in emulated.processes:
            for name, address in addresses.items():
                if name.split(".")[0] == process.name:
                    console.print(f"{name} on {address} (process {process.pid})", highlight=False)
        try:
            console.print("Ctrl-C ends them")
            signal.pause()
        except KeyboardInterrupt:
            console.print("ended")
    return 0
