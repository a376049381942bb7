"""Checks of a rig's links on this computer: serial ports, CAN interfaces, hosts. Nothing is opened."""

from __future__ import annotations

import os
import socket
from pathlib import Path

from serial.tools import list_ports

from hil.config.rig import Rig
from hil.preflight.check import PreflightCheck

_NETWORK = Path("/sys/class/net")


def port_checks(rig: Rig) -> list[PreflightCheck]:
    """Return a check per link of ``rig``; a kind without a check is reported as not checked."""
    checks = {"serial": _serial, "tcp": _tcp, "can": _can}
    return [
        checks[wire.kind](wire.key, wire.address)
        if wire.kind in checks
        else PreflightCheck(f"wire {wire.key}", None, f"{wire.address}: not checked, no port of this computer")
        for wire in rig.wires()
        if wire.address is not None
    ]


def _serial(key: str, address: str) -> PreflightCheck:
    name = f"port {key}"
    if not Path(address).exists():
        present = ", ".join(sorted(port.device for port in list_ports.comports())) or "none"
        return PreflightCheck(
            name, False, f"{address}: no such port", f"connect it or correct the key; present: {present}"
        )
    if not os.access(address, os.R_OK | os.W_OK):
        group = _group_of(address)
        advice = f"sudo usermod -aG {group} $USER, then log in again"
        return PreflightCheck(name, False, f"{address}: no read and write permission for this user", advice)
    return PreflightCheck(name, True, f"{address}: readable and writable")


def _group_of(path: str) -> str:
    try:
        return Path(path).group()
    except (OSError, KeyError):
        return "dialout"


def _tcp(key: str, address: str) -> PreflightCheck:
    name = f"host {key}"
    host, _, port = address.rpartition(":")
    try:
        resolved = socket.getaddrinfo(host, int(port), type=socket.SOCK_STREAM)[0][4][0]
    except OSError as error:
        advice = "correct the key, or add the host to /etc/hosts"
        return PreflightCheck(name, False, f"{address}: {error.strerror or error}", advice)
    found = address if resolved == host else f"{address} is {resolved}"
    return PreflightCheck(name, True, found)


def _can(key: str, address: str) -> PreflightCheck:
    name = f"CAN {key}"
    state = _NETWORK / address / "operstate"
    if not state.exists():
        advice = f"connect {address} or create it with ip link add; see ip -details link"
        return PreflightCheck(name, False, f"{address}: no such interface", advice)
    operstate = state.read_text(encoding="ascii").strip()
    if operstate == "down":
        return PreflightCheck(name, False, f"{address}: down", f"sudo ip link set {address} up type can bitrate ...")
    return PreflightCheck(name, True, f"{address}: {operstate}")
