"""The fault switches of a session's emulated devices, by their control ports."""

from __future__ import annotations

import asyncio
import json
from typing import Any, Final

from hil.console.lease import LeaseRefused
from hil.drivers.fault_injection import FaultControl

_SUFFIX: Final = ".faults"
_VERBS: Final = ("on", "off", "clear")
_ANSWER_WALL_S: Final = 1.0


class FaultInjectionPanel:
    """What can go wrong in which device, and what is switched on. The ports answer in threads: none is waited for."""

    def __init__(self) -> None:
        self._ports: dict[str, str] = {}
        self.menu: dict[str, Any] = {}
        self.on: dict[str, str] = {}

    async def connect(self, addresses: dict[str, str]) -> None:
        """Ask each device of ``addresses`` (name -> address) that has a control port what it can have."""
        self._ports = {n.removesuffix(_SUFFIX): a for n, a in addresses.items() if n.endswith(_SUFFIX)}
        self.menu = {device: json.loads(await self._say(device, "kinds")) for device in self._ports}
        self.on = dict.fromkeys(self._ports, "none")

    def disconnect(self) -> None:
        """The devices are gone."""
        self._ports, self.menu, self.on = {}, {}, {}

    async def switch(self, device: str, line: str) -> None:
        """Say ``line`` (on FAULT, off FAULT, clear) to ``device``; Refused, with its words, where it will not."""
        if device not in self._ports:
            raise LeaseRefused(
                f"{device}: no emulated device with fault switches; here: {', '.join(self._ports) or 'none'}"
            )
        if line.split(" ")[0] not in _VERBS or "\n" in line:
            raise LeaseRefused(f"{line!r}: allowed: on FAULT, off FAULT, clear")
        await self._say(device, line)
        self.on[device] = await self._say(device, "list")

    async def _say(self, device: str, line: str) -> str:
        return await asyncio.to_thread(_say, self._ports[device], line)


def _say(address: str, line: str) -> str:
    try:
        control = FaultControl(address, _ANSWER_WALL_S)
        try:
            return control.send(line)
        finally:
            control.close()
    except ValueError as refusal:
        raise LeaseRefused(str(refusal)) from refusal
    except OSError as cause:
        raise LeaseRefused(f"{address}: the device's control port does not answer: {cause}") from cause
