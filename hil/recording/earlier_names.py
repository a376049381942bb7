"""Earlier names of keys in recordings of version 0.1, which are read under the present ones."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

Table = dict[str, Any]
Path = tuple[str, ...]

_RENAMED: Final[Mapping[str, Mapping[str, str]]] = {
    "Scenario": {
        "vmu.duplicate_share": "vmu.duplicate_probability",
        "vmu.loss_share": "vmu.loss_probability",
        "vmu.pictures": "vmu.images",
        "gnc.navigation.sensors": "gnc.navigation.backend",
        "gnc.guidance.phases.*.until_s": "gnc.guidance.phases.*.end_time_s",
        "gnc.control.caution": "gnc.control.deadband_sigmas",
        "gnc.control.attitude_caution": "gnc.control.attitude_deadband_sigmas",
        "reach.corridor_share": "reachability.corridor_fraction",
        "reach.catch_up_s": "reachability.startup_lag_s",
        "reach": "reachability",
        "monitor.camera_station_m": "monitor.camera_position_m",
        "monitor.target_station_m": "monitor.target_position_m",
        "orbit.moon_rotation_deg": "orbit.body_rotation_deg",
    },
    "Rig": {
        "bench.camera_station_m": "bench.camera_position_m",
        "bench.ring_station_m": "bench.led_ring_position_m",
        "bench.ring_axes": "bench.led_ring_axes",
        "rails.lost_packets_forget_s": "rails.lost_packets_window_s",
        "turntable.lost_packets_forget_s": "turntable.lost_packets_window_s",
        "target_manipulator.lost_packets_forget_s": "target_manipulator.lost_packets_window_s",
        "vmu.lost_packets_forget_s": "vmu.lost_packets_window_s",
        "host.insist_on_realtime": "host.require_realtime",
        "host.late_cycle": "host.on_overrun",
        "host.late_cycles_max": "host.overruns_max",
        "host.late_cycles_window_s": "host.overruns_window_s",
        "gnc_link.answer_share": "gnc_link.reply_timeout_fraction",
        "gnc_link.rejoin_s": "gnc_link.reconnect_timeout_s",
        "flight_computer.words": "flight_computer.command_words",
        "recording.pictures": "recording.images",
        "recording.picture_each_s": "recording.image_interval_s",
    },
    "Scene": {"reserve": "backup"},
    "VmuGeometry": {
        "calibration.camera_station_m": "calibration.camera_position_m",
        "calibration.target_station_m": "calibration.target_position_m",
    },
}
"""Model -> earlier key -> present key. ``*``: any name. A key stands before its table."""
_VALUES: Final[Mapping[Path, Mapping[str, str]]] = {
    ("monitor", "target"): {"reserve": "backup"},
    ("gnc", "navigation", "backend"): {"vision_imu": "builtin", "vision": "vision_alone"},
}
"""Present key of a scenario -> earlier value -> present value."""
_REMOVED: Final[tuple[Path, ...]] = (("gnc", "vision_only"), ("gnc", "akf", "form"))
_KEYS: Final = ("console", "adjustable")  # a list of keys


def with_present_names(model: str, table: Table) -> Table:
    """Return a recorded ``table`` under the present names of the keys of ``model``."""
    present: Table = {}
    for path, value in _leaves(table):
        start = 1 if path[0] == "dispersions" else 0  # it repeats the scenario's tables
        if any(path[start : start + len(gone)] == gone for gone in _REMOVED):
            continue
        *parents, last = (*path[:start], *_renamed(model, path[start:]))
        if (*parents, last) == _KEYS:
            value = [present_key(model, key) for key in value]
        elif model == "Scenario" and isinstance(value, str):
            value = _VALUES.get((*parents, last), {}).get(value, value)
        place = present
        for parent in parents:
            place = place.setdefault(parent, {})
        place[last] = value
    return present


def present_key(model: str, key: str) -> str:
    """Return the present name of the dotted ``key``."""
    return ".".join(_renamed(model, tuple(key.split("."))))


def _leaves(table: Table, at: Path = ()) -> Iterator[tuple[Path, Any]]:
    """Yield the path and the value of each key that is not a table, and of each empty table."""
    for key, value in table.items():
        if isinstance(value, dict) and value:
            yield from _leaves(value, (*at, key))
        else:
            yield (*at, key), value


def _renamed(model: str, path: Path) -> Path:
    for old, new in _RENAMED.get(model, {}).items():
        parts = old.split(".")
        own = path[: len(parts)]
        if len(own) == len(parts) and all(part in ("*", name) for part, name in zip(parts, own, strict=True)):
            names = (name if part == "*" else part for part, name in zip(new.split("."), own, strict=True))
            return (*names, *path[len(parts) :])
    return path
