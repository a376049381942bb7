"""Rig files, table ``[clock]``: synchronisation of the computer's clock."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from hil.config.model import ConfigModel, Positive


class ClockConfig(ConfigModel):
    """Synchronisation by PTP: linuxptp's `ptp4l` on this computer."""

    ptp_socket: str = "/var/run/ptp4l"
    """Management socket of `ptp4l`; without that file the computer has no PTP."""
    ptp_domain: Annotated[int, Field(ge=0, le=127)] = 0
    """PTP domain number."""
    ptp_max_offset_us: Positive | None = None
    """Largest offset from the master: a run is rejected beyond it, or without a master. Unless set, reported only."""
