"""The operator behind the console's socket: his orders, and what the loop does when he is lost."""

from __future__ import annotations

import base64
import json
import lzma
import socket
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from hil.config.load import load_scenario
from hil.config.tables.host import OnLoss
from hil.core.clock import SimulatedClock
from hil.core.modes import Mode
from hil.core.operator_commands import TOO_LATE
from hil.frmn.mailbox import MailboxBlock
from hil.gnc_backends.builtin import BuiltinGnc
from hil.loop.outcome import Outcome
from hil.loop.rate_keeper import SimulatedRate
from hil.loop.runner import STOPPED_BY_OPERATOR, Runner
from hil.loop.session_parts import SessionParts
from hil.params import gnc as gnc_params
from hil.parts.console.freshness import ACT_S
from hil.parts.console.remote_operator import OutgoingMessages, RemoteOperator
from hil.parts.console.status import CELLS, MODES, empty_status, status_of
from hil.session import build
from hil.session.live_tuning import packed
from tests.support.run_settings import make_job

LEASE_S = 1.0
SHORT = base64.b64encode(lzma.compress(b"abc")).decode()
DEADBAND = "gnc.control.deadband_deg"


@dataclass
class Talk:
    """The console's end of the line, on a bench in simulated time."""

    end: socket.socket
    runner: Runner
    status: Any
    now_s: float = 0.0
    beats: bool = True
    present: bool = True
    button: bool = False
    said: list[dict[str, Any]] = field(default_factory=list)
    modes: list[Mode] = field(default_factory=list)
    done: dict[str, float] = field(default_factory=dict)
    left_s: dict[Mode, float] = field(default_factory=dict)

    @property
    def mode(self) -> Mode:
        return self.runner.safety.modes.mode

    def send(self, **message: Any) -> None:
        self.end.send(json.dumps(message).encode())

    def once(self, step: str, condition: bool) -> bool:
        if step in self.done or not condition:
            return False
        self.done[step] = self.now_s
        return True

    def since_s(self, step: str) -> float:
        return self.now_s - self.done.get(step, self.now_s)

    def order(self, word: str, condition: bool) -> None:
        if self.once(word, condition):
            self.send(order=word, confirmed=True, id=len(self.done))

    def fly(self) -> None:
        """Arm and start."""
        self.order("arm", self.mode is Mode.STANDBY and self.now_s > 0.1)
        self.order("start", self.mode is Mode.ARMED)

    def answers(self) -> list[str]:
        return [message["text"] for message in self.said if "answer" in message]

    def take(self) -> None:
        while True:
            try:
                self.said.append(json.loads(self.end.recv(1 << 18)))
            except BlockingIOError:
                return


Script = Callable[[Talk], None]


def converse(
    script: Script,
    on_loss: OnLoss = "hold",
    duration_s: float = 2.0,
    settings: tuple[str, ...] = (),
    frames_to_arm: int = 0,
) -> tuple[Outcome, Talk]:
    """Run scheme 1 on the mock rig; ``script`` is called before each look at the encoders. It ends by itself."""
    job = make_job(duration_s, settings)
    here, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    here.setblocking(False)
    block = MailboxBlock.create(CELLS, "console")
    rate = SimulatedRate(SimulatedClock(), job.scenario.value.step_s)
    operator = RemoteOperator(OutgoingMessages(there), block["status"], on_loss, LEASE_S, rate.now_s)
    runner = build.in_memory(job, rate, SessionParts(operator, operator.on_progress, frames_to_arm=frames_to_arm))
    operator.attach(runner, adjustable=(DEADBAND,))
    talk = Talk(here, runner, block["status"])

    def look(now_s: float) -> tuple[bool | None, bool]:
        talk.now_s = now_s
        if not talk.modes or talk.modes[-1] is not talk.mode:
            talk.left_s.update(dict.fromkeys(talk.modes[-1:], now_s))
            talk.modes.append(talk.mode)
        if talk.beats and here.fileno() >= 0:
            talk.send(present=talk.present)
            talk.take()
        script(talk)
        if now_s > 60.0:  # a script that forgets to end
            raise AssertionError(f"still {talk.mode.value} after 60 s: {talk.said[-3:]}")
        return talk.button, False

    runner.loop.bench.emergency_input = look
    try:
        outcome = runner.run()
        operator.publish(talk.now_s)
        if here.fileno() >= 0:
            talk.take()
        return outcome, talk
    finally:
        here.close()
        there.close()
        block.close()


def given(talk: Talk, word: str, condition: bool) -> None:
    """Give an order that may be executed within 0.5 s, as the console passes it on."""
    if talk.once(word, condition):
        talk.send(order=word, confirmed=True, id=len(talk.done), until_s=talk.now_s + ACT_S)


def test_resume_that_the_gnc_delays_is_not_executed_later(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(BuiltinGnc, "blocking_reason", property(lambda gnc: reason[0]))
    reason = [""]

    def script(talk: Talk) -> None:
        talk.fly()
        talk.order("hold", talk.mode is Mode.RUNNING and talk.runner.loop.now.t_s[0] > 0.5)
        held = talk.mode is Mode.HOLD and talk.since_s("hold")
        reason[0] = "no answer of the flight computer" if held and held < 4.0 else ""
        given(talk, "resume", held > 2.0)
        talk.order("stop", held > 6.0)

    outcome, talk = converse(script)
    assert outcome.stop == STOPPED_BY_OPERATOR
    assert talk.modes[-2:] == [Mode.RUNNING, Mode.HOLD]
    words = [message["word"] for message in talk.said if "word" in message]
    assert words == [f"bench: resume {TOO_LATE} (no answer of the flight computer)"]


@pytest.mark.parametrize("word", ["start", "stop", "disarm"])
def test_armed_bench_without_frames_never_starts_late_and_stops_at_once(
    word: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def script(talk: Talk) -> None:
        talk.order("arm", talk.mode is Mode.STANDBY and talk.now_s > 0.1)
        armed_s = talk.since_s("arm")
        monkeypatch.setattr(talk.runner.loop.vision, "discard_pending", lambda _: int(armed_s > 3.0))
        given(talk, word, talk.mode is Mode.ARMED and armed_s > 1.0)
        talk.order("stop", armed_s > 5.0)

    _, talk = converse(script, frames_to_arm=2)
    assert Mode.RUNNING not in talk.modes
    if word == "start":
        assert [m["word"] for m in talk.said if "word" in m] == [f"bench: start {TOO_LATE}"]
    else:
        left_s = {"stop": talk.now_s, "disarm": talk.left_s.get(Mode.ARMED, 99.0)}[word]
        assert left_s - talk.done[word] < 0.1


def test_run_goes_by_orders_over_the_line_with_hold_and_resume() -> None:
    def script(talk: Talk) -> None:
        talk.fly()
        talk.order("hold", talk.mode is Mode.RUNNING and talk.runner.loop.now.t_s[0] > 0.5)
        talk.order("resume", talk.mode is Mode.HOLD)

    outcome, talk = converse(script)
    assert outcome.stop == "completed"
    assert [mode for mode in talk.modes if mode is not Mode.OFF] == [
        Mode.STANDBY,
        Mode.ARMED,
        Mode.RUNNING,
        Mode.HOLD,
        Mode.RUNNING,
    ]
    assert talk.answers() == [""] * 4
    assert any("hold: commanded by the operator" in e["text"] for m in talk.said for e in m.get("events", []))


def test_order_that_its_mode_does_not_allow_is_refused_with_a_message_and_does_nothing() -> None:
    def script(talk: Talk) -> None:
        talk.order("start", talk.mode is Mode.STANDBY)
        talk.order("stop", bool(talk.answers()))

    outcome, talk = converse(script)
    assert talk.answers()[0] == "bench: cannot start in standby"
    assert len(outcome.history) == 0


@pytest.mark.parametrize("how", ["silent", "absent"])
def test_lost_operator_holds_a_run_and_only_an_order_resumes_it(how: str) -> None:
    def script(talk: Talk) -> None:
        talk.fly()
        if talk.once("lose", talk.mode is Mode.RUNNING and talk.runner.loop.now.t_s[0] > 0.5):
            talk.beats, talk.present = how != "silent", False
        if talk.once("back", talk.mode is Mode.HOLD and talk.now_s - talk.done["lose"] > 5.0):
            talk.beats = talk.present = True
        talk.order("resume", "back" in talk.done and talk.now_s - talk.done["back"] > 1.0)

    outcome, talk = converse(script)
    assert outcome.stop == "completed"
    assert talk.modes.count(Mode.HOLD) == 1
    (event,) = [event.text for event in outcome.events if event.text.startswith("hold: ")]
    assert event.startswith("hold: console: operator's page silent for 1")
    assert event.endswith("allowed 1 s")
    assert not outcome.alarms
    assert talk.done["resume"] - talk.done["lose"] > 6.0


def test_lost_operator_does_not_matter_where_the_rig_lets_the_run_continue() -> None:
    def script(talk: Talk) -> None:
        talk.fly()
        talk.beats &= talk.mode is not Mode.RUNNING

    outcome, talk = converse(script, "continue")
    assert outcome.stop == "completed"
    assert Mode.HOLD not in talk.modes


def test_lost_operator_stops_the_bench_with_an_alarm_if_the_rig_is_configured_so() -> None:
    def script(talk: Talk) -> None:
        talk.fly()
        talk.beats &= talk.mode is not Mode.RUNNING

    outcome, _ = converse(script, "stop", duration_s=10.0)
    assert outcome.mode is Mode.SAFE_STOP
    (alarm,) = outcome.alarms
    assert (alarm.device, alarm.limit) == ("console", "1 s of silence while the bench moves")
    assert alarm.quantity == "operator's page"
    assert len(outcome.history) * 0.02 < LEASE_S + 0.1


INCREMENTAL = ('rig.rails.y.encoder="incremental"', "rig.rails.y.home_m=-1.0")


@pytest.mark.parametrize("on_loss", ["hold", "continue", "stop"])
@pytest.mark.parametrize(("order", "mode"), [("home", Mode.HOMING), ("park", Mode.PARKING)])
def test_homing_and_parking_end_when_the_operator_is_lost(order: str, mode: Mode, on_loss: OnLoss) -> None:
    def script(talk: Talk) -> None:
        talk.order(order, talk.mode is Mode.STANDBY)
        if talk.once("lose", talk.mode is mode):
            talk.beats = False
        talk.beats |= talk.mode is Mode.SAFE_STOP
        talk.order("stop", talk.mode is Mode.SAFE_STOP)

    outcome, talk = converse(script, on_loss, settings=INCREMENTAL if order == "home" else ())
    assert outcome.mode is Mode.SAFE_STOP
    (alarm,) = outcome.alarms
    assert alarm.text.startswith("console: operator's page silent for 1")
    assert alarm.t_s - talk.done["lose"] < LEASE_S + 0.1


@pytest.mark.parametrize("on_loss", ["hold", "continue", "stop"])
def test_placing_ends_when_the_operator_is_lost(on_loss: OnLoss) -> None:
    def script(talk: Talk) -> None:
        talk.order("home", talk.mode is Mode.STANDBY)
        talk.order("arm", talk.mode is Mode.STANDBY and Mode.HOMING in talk.modes)
        if talk.once("lose", talk.mode is Mode.PLACING):
            talk.beats = False
        talk.beats |= "lose" in talk.done and talk.now_s - talk.done["lose"] > 3.0
        talk.order("stop", "lose" in talk.done and talk.now_s - talk.done["lose"] > 3.5)

    outcome, talk = converse(script, on_loss, settings=INCREMENTAL)
    assert talk.modes[talk.modes.index(Mode.PLACING) + 1] is (Mode.SAFE_STOP if on_loss == "stop" else Mode.HOLD)
    if on_loss != "stop":
        assert np.abs(talk.runner.loop.now.feedback.rail_mps).max() < 0.01
    assert Mode.ARMED not in talk.modes
    assert bool(outcome.alarms) == (on_loss == "stop")


def test_operator_lost_while_nothing_moves_changes_nothing() -> None:
    def script(talk: Talk) -> None:
        if talk.once("lose", talk.mode is Mode.STANDBY):
            talk.beats = False
        talk.beats |= talk.now_s > 5.0
        talk.order("stop", talk.now_s > 6.0)

    outcome, talk = converse(script, "stop")
    assert outcome.stop == STOPPED_BY_OPERATOR
    assert not outcome.alarms
    assert talk.now_s > 6.0


@pytest.mark.parametrize(("on_loss", "cycles"), [("hold", 60), ("continue", 101), ("stop", 60)])
def test_session_without_its_console_ends_by_itself_with_the_bench_at_rest(on_loss: OnLoss, cycles: int) -> None:
    def script(talk: Talk) -> None:
        talk.fly()
        if talk.once("die", talk.mode is Mode.RUNNING and talk.runner.loop.now.t_s[0] >= 1.0):
            talk.end.close()

    outcome, talk = converse(script, on_loss)
    assert len(outcome.history) == pytest.approx(cycles, abs=10)
    assert not np.abs(talk.runner.loop.bench.motion.rate).max() > 0.05
    if on_loss == "continue":
        assert outcome.stop == "completed"
    elif on_loss == "hold":
        assert Mode.HOLD in talk.modes
        assert outcome.stop == STOPPED_BY_OPERATOR
    else:
        assert outcome.alarms[0].text.startswith("console: console process disconnected")


def test_alarm_is_reported_latched_acknowledged_over_the_line_and_reset() -> None:
    def script(talk: Talk) -> None:
        if talk.once("fail", talk.mode is Mode.STANDBY and talk.now_s > 0.2):
            talk.button = True
        if talk.once("acknowledge", any(message.get("alarms") for message in talk.said)):
            talk.send(acknowledge=True, id=77)
        if talk.once("release", "acknowledge" in talk.done and 77 in [m.get("answer") for m in talk.said]):
            talk.send(order="stop", id=78)

    _, talk = converse(script)
    told = [message["alarms"][0] for message in talk.said if message.get("alarms")]
    assert told[0]["text"] == "bench: emergency stop pressed, allowed released and reset"
    assert (told[0]["latched"], told[0]["acknowledged"]) == (True, False)
    assert (told[-1]["latched"], told[-1]["acknowledged"]) == (True, True)


def test_status_has_mode_and_axes_in_shared_memory() -> None:
    seen = []

    def script(talk: Talk) -> None:
        record = empty_status()
        if talk.status.read(record)[0]:
            status = status_of(record)
            seen.append((MODES[int(status.mode)], status.feedback.rail_m.copy(), float(status.age_s[0])))
        talk.fly()

    converse(script, duration_s=0.5)
    assert {Mode.STANDBY, Mode.RUNNING} <= {mode for mode, _, _ in seen}
    assert np.isfinite([position for _, position, _ in seen]).all()
    assert all(age >= 0.0 for _, _, age in seen)


def test_line_without_a_reader_never_stops_the_loop() -> None:
    def script(talk: Talk) -> None:
        talk.take = lambda: None  # type: ignore[method-assign]
        talk.fly()
        if talk.mode is Mode.RUNNING:
            talk.send(order="resume", id=1)  # refused each time

    outcome, _ = converse(script, duration_s=10.0)
    assert outcome.stop == "completed"


def test_setting_is_changed_between_two_cycles_and_what_the_scenario_does_not_allow_is_refused() -> None:
    records = packed(gnc_params.gnc(load_scenario("scheme-1", [f"{DEADBAND}=90.0"]).value))

    def script(talk: Talk) -> None:
        talk.fly()
        running = talk.mode is Mode.RUNNING and talk.runner.loop.now.t_s[0] > 0.5
        for number, (key, text) in enumerate(((DEADBAND, records), ("step_s", records), (DEADBAND, SHORT))):
            if talk.once(f"change {number}", running):
                talk.send(adjust={"key": key, "value": 90, "records": text}, by="ann", id=10 + number)

    outcome, talk = converse(script)
    answers = {message["answer"]: message["text"] for message in talk.said if "answer" in message}
    assert answers[10] == ""
    assert answers[11] == "step_s: not adjustable during a run of this scenario"
    assert answers[12].startswith(f"{DEADBAND}: 3 bytes of parameters, expected")
    (event,) = [event for event in outcome.events if "changed" in event.text]
    assert event.text == f"ann changed {DEADBAND}=90.0, from cycle {round(event.t_s / 0.02) + 1}"
    changed = round(event.t_s / 0.02) + 11  # when the last burn that had begun is over
    assert outcome.history["command"]["torque"][:changed].any()
    assert not outcome.history["command"]["torque"][changed:].any()  # a quarter turn is nothing now
