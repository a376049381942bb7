"""Discrete I/O: a coupler of digital lines with the emergency stop, the charge pump and the thrusters' lines."""

from __future__ import annotations

from typing import Final

NAME: Final = "io"
