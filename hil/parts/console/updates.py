"""Updates for the clients of the console, each with everything that is new since its last one. No web code."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hil.core.operator_commands import OperatorCommand
from hil.parts.console.columns import COLUMNS, NAMES
from hil.parts.console.freshness import JOG_ROUND_TRIP_S
from hil.parts.console.live_view import Client
from hil.parts.console.message import ImageMessage
from hil.parts.console.session_manager import SessionManager
from hil.parts.console.session_process import SessionProcess


@dataclass(frozen=True)
class SecondPerson:
    """Confirmed command of ``client`` in ``session`` that waits until ``until_wall_s`` for another person."""

    word: str
    client: Client
    command: dict[str, Any]
    until_wall_s: float
    session: SessionProcess | None


class ClientUpdates(SessionManager):
    """Session manager with the updates of its clients, and the command that waits for a second person."""

    second_person: SecondPerson | None = None

    def awaited(self) -> SecondPerson | None:
        """Return the command of the present session that waits for a second person, None if there is none."""
        awaited = self.second_person
        if awaited is None or awaited.session is not self.session or self.wall_s() > awaited.until_wall_s:
            return None
        return awaited

    def update_for(
        self, client: Client
    ) -> tuple[dict[str, Any], dict[str, Any] | None, np.ndarray[Any, Any], int, ImageMessage | None, dict[str, Any]]:
        """Return the arguments of ``message.pack`` for ``client``: everything new since its last update."""
        page = None
        if client.page_seen != self.page_version:
            client.page_seen, page = self.page_version, self._page()
        rows, first, news = self.view.rows_for(client)
        return self._now(client), page, rows.reshape(-1, COLUMNS), first, self.view.picture_for(client), news

    def _now(self, client: Client) -> dict[str, Any]:
        now_s = self.wall_s()
        lease, awaited = self.lease, self.awaited()
        return {
            "wall_s": now_s,
            "mode": self.mode.value,
            "open": self.session is not None,
            "ready": self.session is not None and self.session.ready,
            "lease": {"holder": lease.name, "mine": lease.held_by(client)},
            "me": {"name": client.name, "key": client.key_id, "rights": client.rights},
            "watching": len(self.clients),
            "cameras": self.view.cameras,
            "second_person": {"order": awaited.word, "by": awaited.client.name} if awaited else None,
            "recording": self.state.recording.as_json() if self.session is not None else None,
            **self.state.live(now_s),
        }

    def _page(self) -> dict[str, Any]:
        return {
            "session": self.view.rows.session,
            "columns": NAMES,
            "choice": {"scenario": self.choice.scenario, "rig": self.choice.rig, "seed": self.choice.seed},
            "scenarios": self.scenarios,
            "rigs": self.rigs,
            "commissioning": self.session is not None and self.choice.signed_by is not None,
            "obeyed_in": {order.value: [mode.value for mode in order.modes] for order in OperatorCommand},
            "orders": [[order.value, order.button, order.key] for order in OperatorCommand if order.button],
            "jog_round_trip_s": JOG_ROUND_TRIP_S,
            "stop_reason": self.stop_reason,
            "log": list(self.log_lines)[-40:],
            "settings": self.tuner.available() if self.tuner is not None and self.session is not None else [],
            "faults": {"menu": self.faults.menu, "on": self.faults.on},
            **self.state.page(),
        }
