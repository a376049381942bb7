"""The wires of a rig on this computer: serial ports, CAN interfaces, hosts. Nothing is opened."""

from __future__ import annotations

import os
import socket
from pathlib import Path

from serial.tools import list_ports

from hil.checks.wires import Wire, wires
from hil.config.rig import Rig
from hil.preflight.check import PreflightCheck

_NETWORK = Path("/sys/class/net")


def port_checks(rig: Rig) -> list[PreflightCheck]:
    """Return what this computer says of each wire of ``rig``."""
    look = {"serial": _serial, "tcp": _tcp, "can": _can}
    return [look[wire.kind](wire) for wire in wires(rig) if wire.kind in look]


def _serial(wire: Wire) -> PreflightCheck:
    name = f"port {wire.key}"
    if not Path(wire.address).exists():
        present = ", ".join(sorted(port.device for port in list_ports.comports())) or "none"
        return PreflightCheck(
            name, False, f"{wire.address}: no such port", f"plug it in or correct the key; here: {present}"
        )
    if not os.access(wire.address, os.R_OK | os.W_OK):
        group = _group_of(wire.address)
        advice = f"sudo usermod -aG {group} $USER, then log in again"
        return PreflightCheck(name, False, f"{wire.address}: this user may not read and write it", advice)
    return PreflightCheck(name, True, f"{wire.address}: readable and writable")


def _group_of(path: str) -> str:
    try:
        return Path(path).group()
    except (OSError, KeyError):
        return "dialout"


def _tcp(wire: Wire) -> PreflightCheck:
    name = f"host {wire.key}"
    host, _, port = wire.address.rpartition(":")
    try:
        address = socket.getaddrinfo(host, int(port), type=socket.SOCK_STREAM)[0][4][0]
    except OSError as error:
        advice = "correct the key, or add the host to /etc/hosts"
        return PreflightCheck(name, False, f"{wire.address}: {error.strerror or error}", advice)
    found = wire.address if address == host else f"{wire.address} is {address}"
    return PreflightCheck(name, True, found)


def _can(wire: Wire) -> PreflightCheck:
    name = f"CAN {wire.key}"
    state = _NETWORK / wire.address / "operstate"
    if not state.exists():
        advice = f"ip link add or plug in {wire.address}; see ip -details link"
        return PreflightCheck(name, False, f"{wire.address}: no such interface", advice)
    told = state.read_text(encoding="ascii").strip()
    if told == "down":
        return PreflightCheck(
            name, False, f"{wire.address}: down", f"sudo ip link set {wire.address} up type can bitrate ..."
        )
    return PreflightCheck(name, True, f"{wire.address}: {told}")
