"""The seat of a GNC on another computer, or in another process: our own by ``hil gnc``, or anybody's.

Inputs go out and answers come in as cells over UDP (``hil/frmn/link.py``). In lock-step each cycle waits for its
answer; running free it uses the newest one, which belongs to the cycle before. Without an answer the last command
stands for a cycle or so, then all thrusters are closed; after a few cycles the GNC is lost, and the bench is held
or stopped (docs/two-computers.md). Setpoints follow the truth: nothing that comes late makes them jump.
"""

from __future__ import annotations

import math
import time
from typing import Final

import numpy as np

from hil.config.gnc_link import GncLink
from hil.core.gnc_records import GncMode, GncOrder, GncState
from hil.core.messages import IMU, MAX_POSES, POSE, REFERENCE, TRUTH, Array, Event, new
from hil.core.observable import ObservableList
from hil.errors import LinkLost, LinkTimeout, ProtocolError
from hil.frmn.link import Link
from hil.frmn.mailboxes import Role
from hil.frmn.mirror import MIRRORED
from hil.frmn.udp import Address, shown
from hil.gnc import navigation
from hil.gnc.filter_monitor import FilterMonitor
from hil.gnc_backends import external_records, udp_records
from hil.gnc_backends.approach import Approach
from hil.gnc_backends.base import Poses, Records
from hil.gnc_backends.external import BackendSetup, ExternalGnc
from hil.gnc_backends.udp_receiver import REMEMBERED, Past, ReceiveBuffers
from hil.gnc_backends.udp_replies import ReplyReceiver
from hil.gnc_backends.udp_stats import LinkStats

NAME: Final = "gnc"
_OFFERS: Final = ("gnc.setup", "gnc.input", *MIRRORED)
_WANTS: Final = ("gnc.output", "gnc.flight", "gnc.filters")
_BUSY_S: Final = 0.1  # wall time between two cycles with the loop open after which silence is no wonder
_SILENT_S: Final = 0.35  # wall time after which another GNC may take the place of a silent one: three heartbeats
_IDLE_S: Final = 0.01  # wall time of a cycle of a hold in simulated time
_NO_POSES: Final = np.zeros(MAX_POSES, POSE).view(np.recarray)
_A_POSE: Final = np.zeros(1, POSE).view(np.recarray)
_IDLE_IMU: Final = new(IMU)


def gnc_link(name: str, bind: Address | None, peer: Address | None) -> Link:
    """Return the bench's side of the link. bind: where it listens. peer: the only GNC that is spoken with.

    Raises BadInput where it cannot listen there.
    """
    return Link(Role.DSS, name, _OFFERS, _WANTS, bind, peer, _SILENT_S)


class UdpGnc(ExternalGnc):
    """Flies with the GNC at the other end of ``link``.

    period_s: wall time of a cycle; None in simulated time, where lock-step waits as long as it takes.
    watch: looks at the innovations that the built-in GNC reports. The others: as of ForeignGnc.
    """

    def __init__(
        self,
        link: Link,
        config: GncLink,
        lock_step: bool,
        period_s: float | None,
        watch: FilterMonitor,
        briefing: BackendSetup,
    ) -> None:
        self._inbox = ReceiveBuffers()
        super().__init__(NAME, briefing)
        self.output = self._inbox.output
        self.link = link
        self.account = LinkStats(link, "lock-step" if lock_step else "free-running")
        self.watch = watch
        self._config = config
        self._lock_step = lock_step
        self._period_s = period_s
        patience_s = None if period_s is None else config.reply_timeout_fraction * period_s
        self._answers = ReplyReceiver(NAME, link, self._inbox, self.account, briefing.setup, lock_step, patience_s)
        self._missed = 0  # cycles on end
        self._held_since_s: float | None = None
        self._stood_s = self._judged_from_s = -math.inf
        self._told: tuple[GncOrder, int] = (GncOrder.NONE, -1)  # orders under way, and the cycle that told them last
        self._reference = new(REFERENCE)
        self._past_truth, self._past_imu = Past(TRUTH), Past(IMU)
        link.complaints.subscribe(self._say)

    @property
    def logs(self) -> tuple[ObservableList[Event], ...]:
        """What happened, of the approach, of the GNC and of the filters that it reports."""
        return (*super().logs, self.watch.events)

    @property
    def not_ready(self) -> str:
        """Why a held run cannot go on yet: nobody there, not set up, not working."""
        if not self.link.alive(time.monotonic()):
            return f"{self.name} is silent"
        if not self._answers.is_set_up:
            return f"{self.name} has not answered its setup"
        state = self._answers.state
        if state is not GncState.WORKING:
            return f"{self.name} says {state.name.lower().replace('_', ' ')}"
        return ""

    def connect(self, patience_s: float) -> str:
        """Wait until a GNC has answered its setup, before anything moves; return who it is.

        Raises LinkTimeout that says where it waited.
        """
        give_up_s = time.monotonic() + patience_s
        while not self._answers.is_set_up:
            if time.monotonic() > give_up_s:
                refusal = f"; refused: {self.link.refusal[1]}" if self.link.refusal else ""
                where = shown(self.link.address)
                raise LinkTimeout(self.name, f"none has answered {where} within {patience_s:g} s{refusal}")
            self._answers.poll(self.cycle)
            self.link.wait(_IDLE_S)
        return self._peer_name()

    def stand(self, mode: GncMode, bench_s: float) -> None:
        """Keep the GNC informed while the loop is open, take in one that has come back, and judge silence."""
        self._answers.poll(self.cycle)
        if self._answers.is_set_up:
            self._tell(mode)
        now_s = time.monotonic()
        if now_s - self._stood_s > _BUSY_S:  # the bench was busy, and said nothing itself
            self._judged_from_s = now_s
        self._stood_s = now_s
        judged = now_s - self._judged_from_s > _SILENT_S
        if judged and self._config.on_loss == "stop" and not self.link.alive(now_s):
            raise self._lost(f"has been silent for more than {_SILENT_S:g} s")
        if mode is not GncMode.HOLD:
            self._held_since_s = None
            return
        self._held_since_s = self._held_since_s or now_s
        if self.not_ready and now_s - self._held_since_s > self._config.reconnect_timeout_s:
            raise self._lost(f"has not come back within {self._config.reconnect_timeout_s:g} s")
        if self._period_s is None:
            self.link.wait(_IDLE_S)

    def act(self, t_s: float, now: Records, vision: Poses) -> None:
        """Write the reference, ask the GNC, take what it says, and supervise that."""
        self._reference, self._held_since_s = now.reference, None
        super().act(t_s, now, vision)
        if self._abort_began and self._lock_step and self._missed == 0 and self._inbox.has_flight:
            self._control_again(t_s, now)

    def _control_again(self, t_s: float, now: Records) -> None:
        """Let our GNC decide anew by the reference of an abort that has just begun, as ``hil run`` does."""
        self._abort_began = False
        self._write_input(t_s, GncMode.RUNNING, GncOrder.ABORT, now.imu, now.reference, _NO_POSES, 0)
        self._answers.used -= 1
        if self.exchange(now.reference):
            self._take_answer(now, t_s)
        else:
            self.miss(now)

    def exchange(self, reference: np.record | None = None) -> bool:
        """Send the input; bring an answer into ``output``; False where none that is new is there.

        reference: where this cycle's input goes out a second time, the other REFERENCE that it has now.
        """
        self.link.service()
        if self._lock_step:
            self._send()
            self._answers.wait(self.cycle, self.input, reference)
        else:
            self._answers.hear(self.cycle)
            self._send()
        if not self._answers.take():
            return False
        self.account.used(self.cycle - self._answers.used)
        if self._answers.used >= self._told[1]:
            self._told = (GncOrder.NONE, -1)
        return True

    def take(self, now: Records, cycle: int, t_s: float) -> None:
        """Write NAVIGATION and COMMAND from the answer that is used in ``cycle``. Raises BenchError."""
        self._missed = 0
        if self._take_answer(now, t_s) and (
            math.isfinite(now.navigation.nis_position) or math.isfinite(now.navigation.nis_attitude)
        ):
            self.watch.look(self._answers.used, now.imu, _A_POSE, now.navigation, _NO_POSES)

    def _take_answer(self, now: Records, t_s: float) -> bool:
        """Write NAVIGATION and COMMAND; return whether they are those of our own GNC."""
        super().take(now, self._answers.used, t_s)
        if not self._inbox.has_flight or self.output.state != GncState.WORKING:
            return False
        if not udp_records.take_flight(self._inbox.navigation, self._inbox.command, now.navigation, now.command):
            raise ProtocolError(self.name, "its estimate is not finite")
        return True

    def miss(self, now: Records) -> None:
        """Let the last command stand for a while, then close all thrusters; when it lasts, the GNC is lost."""
        self._missed += 1
        gone = self.link.peer.gone if self.link.peer is not None else None
        why = gone or ("" if self._answers.is_set_up else "was started anew")
        if not why and (self._missed >= self._config.timeout_cycles or self._period_s is None):
            why = "does not answer" if self._period_s is None else f"has not answered for {self._missed} cycles"
        if self._missed <= self._config.coast_cycles and self._answers.used >= 0 and not why:
            self.account.coasted += 1
            now.navigation.nis_position = now.navigation.nis_attitude = math.nan
            return
        self.account.closed += 1
        external_records.rest(now.command)
        external_records.mark_invalid(now.navigation)
        if why:
            self._lose(why)

    def supervise(self, t_s: float, estimate: np.record, reference: np.record, out: np.record) -> None:
        """Judge our own GNC as ``hil run`` does, also before its first pose; others as those that may say nothing."""
        if self._missed == 0 and self._inbox.has_flight:
            aborted = out.aborted
            Approach.supervise(self, t_s, estimate, reference, out)
            self._abort_began = out.aborted != aborted
        else:
            super().supervise(t_s, estimate, reference, out)

    def consistency(self, truth: np.record, imu: np.record) -> Array:
        """Return NEES of position and attitude filter, (2,), of the filters that came in this cycle, nan without."""
        self._past_truth.put(self.cycle, truth)
        self._past_imu.put(self.cycle, imu)
        self._nees[:] = np.nan
        of, self._inbox.filters_of = self._inbox.filters_of, -1
        if of >= 0 and 0 <= self.cycle - of < REMEMBERED:
            then = self._past_truth.at(of), self._past_imu.at(of)
            navigation.normalised_errors(self._inbox.filters, *then, self._nees)
        return self._nees

    def close(self) -> None:
        """Tell the GNC that the run is over."""
        if self._answers.is_set_up:
            self._tell(GncMode.STOPPED)
        self.link.close("the run is over")

    def _tell(self, mode: GncMode) -> None:
        """Send an input without measurements: the loop is open."""
        t_s = max(0.0, self.cycle * float(self.setup.step_s))
        self._write_input(t_s, mode, GncOrder.NONE, _IDLE_IMU, self._reference, _NO_POSES, 0)
        self._send()

    def _write_input(
        self,
        t_s: float,
        mode: GncMode,
        orders: GncOrder,
        imu: np.record,
        reference: np.record,
        poses: np.ndarray,
        arrived: int,
    ) -> None:
        under_way, told_in = self._told
        if under_way and mode is GncMode.RUNNING and self.cycle - told_in >= 2:
            orders |= under_way  # the input that said so, or the answer to it, was lost
        if orders:
            self._told = (orders, self.cycle)
        super()._write_input(t_s, mode, orders, imu, reference, poses, arrived)

    def _send(self) -> None:
        self.account.sent(self.cycle)
        self.link.send("gnc.input", self.input)

    def _lose(self, why: str) -> None:
        self.account.losses += 1
        if self.link.peer is None or self.link.peer.gone:
            self._answers.forget_setup()
        self._answers.state = GncState.STARTING
        if self._config.on_loss == "stop":
            raise self._lost(why)
        self.request_hold(f"{self._peer_name()} {why}")

    def _lost(self, why: str) -> LinkLost:
        return LinkLost(self.name, f"{self._peer_name()} {why}")

    def _peer_name(self) -> str:
        peer = self.link.peer
        if peer is None:
            return "nobody"
        return f"{peer.hello.name} at {shown(peer.address)}" if peer.hello is not None else shown(peer.address)

    def _say(self, complaint: str) -> None:
        self.words.append(Event(max(0.0, self.cycle * float(self.setup.step_s)), "gnc link", complaint))
