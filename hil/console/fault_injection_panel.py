"""Fault injection into a session's emulated devices, through their control ports."""

from __future__ import annotations

import asyncio
import json
from typing import Any, Final

from hil.console.lease import RequestRejected
from hil.drivers.fault_injection import FaultControl

_SUFFIX: Final = ".faults"
_VERBS: Final = ("on", "off", "clear")
_TIMEOUT_WALL_S: Final = 1.0


class FaultInjectionPanel:
    """Available and active faults per device. The control ports are accessed in threads, without blocking the loop."""

    def __init__(self) -> None:
        self._ports: dict[str, str] = {}
        self.menu: dict[str, Any] = {}
        self.on: dict[str, str] = {}

    async def connect(self, addresses: dict[str, str]) -> None:
        """Query the available faults of each device of ``addresses`` (name -> address) with a control port."""
        self._ports = {n.removesuffix(_SUFFIX): a for n, a in addresses.items() if n.endswith(_SUFFIX)}
        self.menu = {device: json.loads(await self._send(device, "kinds")) for device in self._ports}
        self.on = dict.fromkeys(self._ports, "none")

    def disconnect(self) -> None:
        """Clear everything: the devices are gone."""
        self._ports, self.menu, self.on = {}, {}, {}

    async def switch(self, device: str, line: str) -> None:
        """Send ``line`` (on FAULT, off FAULT, clear) to ``device``; raise RequestRejected with its reason."""
        if device not in self._ports:
            raise RequestRejected(
                f"{device}: no emulated device with fault switches; present: {', '.join(self._ports) or 'none'}"
            )
        if line.split(" ")[0] not in _VERBS or "\n" in line:
            raise RequestRejected(f"{line!r}: allowed: on FAULT, off FAULT, clear")
        await self._send(device, line)
        self.on[device] = await self._send(device, "list")

    async def _send(self, device: str, line: str) -> str:
        return await asyncio.to_thread(_send, self._ports[device], line)


def _send(address: str, line: str) -> str:
    try:
        control = FaultControl(address, _TIMEOUT_WALL_S)
        try:
            return control.send(line)
        finally:
            control.close()
    except ValueError as refusal:
        raise RequestRejected(str(refusal)) from refusal
    except OSError as cause:
        raise RequestRejected(f"{address}: the device's control port does not respond: {cause}") from cause
