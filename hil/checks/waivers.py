"""Protections that a rig or a scenario gives up, or weakens, by its own file or options."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass

from hil.checks.compatibility import sign_off_gap
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.config.tables.limits import RIG_LIMITS, scenario_limits, values
from hil.errors import BadInput


@dataclass(frozen=True)
class Waiver:
    """A key of rig or scenario, its value, and the protection that is absent or weak because of it."""

    key: str
    value: str
    takes_away: str

    def __str__(self) -> str:
        return f"WAIVED {self.key} = {self.value}: {self.takes_away}"

    def as_json(self) -> dict[str, str]:
        """Return the entry of ``waived`` in the JSON."""
        return dataclasses.asdict(self)


def waivers(rig: Rig, scenario: Scenario) -> list[Waiver]:
    """Return the limits that are weaker than recommended, on every kind of rig, and what hardware waives."""
    waived = list(_waivers(rig)) if rig.kind == "hardware" else []
    waived += _open_volume(rig, scenario)
    for prefix, limits, table in (("rig.", RIG_LIMITS, rig), ("", scenario_limits(rig.has_vmu), scenario)):
        for key, limit, value in values(limits, table):
            if limit.is_weaker(value, limit.recommended):
                text = f"weak protection from {limit.protects}, recommended {limit.range_text(limit.recommended)}"
                waived.append(Waiver(f"{prefix}{key}", f"{value:g}", text))
    return waived


def _open_volume(rig: Rig, scenario: Scenario) -> Iterator[Waiver]:
    """Yield what the guard volume lacks, on every kind of rig."""
    keep_out = scenario.keep_out
    if (
        not rig.bench.bodies and rig.floating is None and rig.shared_rails is None
    ):  # those of the keep-out are monitored
        yield Waiver(
            "rig.bench.bodies",
            "none",
            "collisions of carriage and turntable with the target are not monitored, only the keep-out of the chaser's "
            "reference point",
        )
    if not keep_out.bodies:
        yield Waiver(
            "keep_out.bodies",
            "none",
            "chaser and target are kept apart by their reference points alone, not by their shapes",
        )
    if keep_out.docks:
        yield Waiver("keep_out.docks", "true", "within the corridor the chaser may move up to contact")
    if keep_out.inspects:
        yield Waiver("keep_out.inspects", "true", "no half-space keeps the chaser in front of the target")


def _waivers(rig: Rig) -> Iterator[Waiver]:
    if not rig.has_io:
        yield Waiver(
            "rig.io.driver",
            "none",
            "emergency stop, interlocks and safety chain are not read, and no stop opens the chain: the axes of a "
            "controller that hangs or dies are stopped by their drives alone",
        )
    if rig.sign_off is not None and rig.sign_off.waived:
        gap = sign_off_gap(rig)
        lost = f"the sign-off {gap}" if gap else "a change of the rig after its sign-off is accepted"
        yield Waiver(
            "rig.sign_off.waived", "true", f"axes, limits and safety chain may differ from what was tested: {lost}"
        )
    if not rig.host.require_realtime:
        yield Waiver(
            "rig.host.require_realtime",
            "false",
            "the loop may run without real-time priority and locked memory: other programs can delay it",
        )
    if rig.on_overrun == "log":
        yield Waiver("rig.host.on_overrun", "log", "lost periods are counted only: the bench moves on late setpoints")
    if not rig.guard.enabled:
        yield Waiver(
            "rig.guard.enabled",
            "false",
            "a GNC may move the carriage into the target, and an axis that does not follow is found late",
        )
    if rig.console.on_loss == "continue":
        yield Waiver(
            "rig.console.on_loss", "continue", "the bench moves on unattended when page, network or console is lost"
        )
    if rig.holding_brakes and (rig.io is None or rig.io.inputs.brakes_closed is None):
        yield Waiver(
            "rig.io.inputs.brakes_closed",
            "not set",
            "holding brakes are not read back: torque is removed from gravity-loaded axes after brake.close_s",
        )
    for name, table in rig.device_tables().items():
        try:
            lacking = table.entry.check_files(table) if table.has_wires else []
        except BadInput as error:  # a recording is read on a computer without the file
            lacking = [str(error)]
        yield from (Waiver(f"rig.{name}.driver", table.driver, line) for line in lacking)
