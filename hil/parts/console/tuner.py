"""What the operator changes in flight: live settings, and injected faults."""

from __future__ import annotations

import asyncio
import json
import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from hil.config.live_tunable import BACKEND_SETTINGS, range_of, value_of, within
from hil.config.load import Loaded
from hil.config.scenario import Scenario
from hil.core.part import provided
from hil.gnc_backends.backend_registry import declared_setting
from hil.params import gnc as gnc_params
from hil.parts.console.lease import RequestRejected
from hil.session.assembly import Job
from hil.session.live_tuning import check_in_flight, packed, with_setting

_UNITS: Final = {
    "_per_s": "1/s",
    "_mps": "m/s",
    "_mps2": "m/s\u00b2",
    "_mps3": "m/s\u00b3",
    "_degps": "\u00b0/s",
    "_degps2": "\u00b0/s\u00b2",
    "_deg": "\u00b0",
    "_sigma": "\u03c3",
    "_m": "m",
    "_s": "s",
}
"""Unit by the ending of a key; the first match applies."""


def unit_of(key: str) -> str:
    """Return the unit named by the ending of ``key``, "" for a dimensionless number."""
    return next((unit for ending, unit in _UNITS.items() if key.endswith(ending)), "")


@dataclass(frozen=True)
class Change:
    """Checked change of one setting. scenario: with the new value; records: parameters for the loop."""

    key: str
    before: float
    value: float
    scenario: Loaded[Scenario]
    records: np.record

    @property
    def question(self) -> str:
        unit = unit_of(self.key)
        return f"{self.key}: from {self.before:g} to {self.value:g}{unit and f' {unit}'}, from the next cycle?"

    def as_message(self) -> dict[str, Any]:
        """Return the change for the session's process."""
        return {"key": self.key, "value": self.value, "records": packed(self.records)}


def _range(scenario: Scenario, key: str) -> dict[str, Any]:
    """Return the limits of a setting during a run, as ``range_of``; those of a backend's are as it declares them."""
    if not key.startswith(BACKEND_SETTINGS):
        return range_of(Scenario, key)
    setting = declared_setting(scenario, key)
    low, high = (limit if math.isfinite(limit) else None for limit in (setting.low, setting.high))
    return {"low": low, "high": high, "low_open": False, "high_open": False, "words": setting.allowed}


class Tuner:
    """Adjustable settings of one session; ``applied`` must be called with each change that the loop has accepted."""

    def __init__(self, job: Job) -> None:
        self._scenario = job.scenario
        self._rig = job.rig

    def available(self) -> list[dict[str, Any]]:
        """Return the adjustable settings: key, unit, present value and allowed range."""
        scenario = self._scenario.value
        return [
            {
                "key": key,
                "unit": unit_of(key),
                "value": value_of(scenario, key),
                "range": _range(scenario, key),
            }
            for key in scenario.console.adjustable
        ]

    def change(self, key: object, value: object) -> Change:
        """Return the change of ``key`` to ``value``. Raises RequestRejected, or BadInput for an invalid one."""
        scenario = self._scenario.value
        allowed = scenario.console.adjustable
        if key not in allowed or not isinstance(key, str):
            raise RequestRejected(
                f"{key!r}: not adjustable during a run of this scenario, allowed {', '.join(allowed) or 'none'}"
            )
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise RequestRejected(f"{key}: {value!r} is not a number")
        allowed_range = _range(scenario, key)
        if not within(allowed_range, float(value)):
            raise RequestRejected(f"{key}: {value:g}: during a run allowed {allowed_range['words']}")
        changed = with_setting(scenario, f"{key}={float(value)!r}", self._scenario.source)
        check_in_flight(changed, self._rig)
        return Change(key, value_of(scenario, key), float(value), changed, gnc_params.gnc(changed.value))

    def applied(self, change: Change) -> None:
        """Make the scenario of ``change`` the present one."""
        self._scenario = change.scenario


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
        control = provided("rig.kind=emulated: faults")(address, _TIMEOUT_WALL_S)
        try:
            answer: str = control.send(line)
            return answer
        finally:
            control.close()
    except ValueError as refusal:
        raise RequestRejected(str(refusal)) from refusal
    except OSError as cause:
        raise RequestRejected(f"{address}: the device's control port does not respond: {cause}") from cause
