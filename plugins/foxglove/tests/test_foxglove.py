"""Foxglove at a console with a session: commands, a setting in flight, another client's hold, the recording of it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from hil.recording.read import load
from hil.recording.replay import replay
from plugins.foxglove.tests.foxglove_client import FoxgloveClient
from tests.support.console_client import PATIENT, console
from tests.support.run_settings import NEAR, typed

pytest.importorskip("foxglove")
pytestmark = [pytest.mark.wires, pytest.mark.slow]

DEADBAND = "gnc.control.deadband_m"


def test_session_is_commanded_tuned_and_held_from_foxglove_and_replays_bit_by_bit(tmp_path: Path) -> None:
    arguments = ("--rig", "mock", "--foxglove", "0", *PATIENT, *typed(*NEAR))
    with console(*arguments, record=tmp_path) as c:
        assert c.process.stderr is not None
        found = re.search(r"foxglove on (ws\S+); code to take the command: (\w+)", c.process.stderr.readline())
        assert found is not None
        with FoxgloveClient(found[1]) as ann, FoxgloveClient(found[1], frozenset({"/bench"})) as bob:

            def until(mode: str) -> None:
                ann.until(lambda: bool(ann.of("/bench")) and ann.of("/bench")[-1].json["mode"] == mode, mode, 120.0)

            until("off")
            assert ann.call("/hil/take", name="ann", code=found[2])["ok"]
            assert "confirmed" not in ann.call("/hil/open")
            assert ann.confirm("/hil/open")["ok"]
            until("standby")
            for order, mode in (("arm", "armed"), ("start", "running")):
                assert ann.confirm(f"/hil/{order}")["ok"]
                until(mode)
            ann.until(lambda: len(ann.of("/cycle")) > 100, "cycles")
            for topic in ("/state", "/tf", "/vmu/frames", "/scene"):
                ann.until(lambda topic=topic: bool(ann.of(topic)), topic)  # type: ignore[misc]
            assert bob.set_parameter(DEADBAND, 0.0004)[DEADBAND] != 0.0004
            assert ann.confirm("/hil/adjust", key=DEADBAND, value=0.0004)["ok"]
            bob.until(lambda: bool(bob.of("/bench")), "a message")
            assert bob.call("/hil/hold")["ok"]
            until("hold")
            assert "ann has the command" in bob.call("/hil/resume", confirmed=True)["text"]
            assert "digits that are shown" in ann.call("/hil/resume", confirmed=True)["text"]
            assert ann.confirm("/hil/resume")["ok"]
            until("running")
            assert bob.call("/hil/stop")["ok"]
            ann.until(lambda: not ann.of("/bench")[-1].json["open"], "the end")
            log = [message.json["message"] for message in ann.of("/log")]
    recorded = load(next(tmp_path.glob("*.mcap")))
    assert recorded.intact
    assert replay(recorded, recorded.scenario).identical
    assert f"{DEADBAND}=0.0004" in [note["message"] for note in recorded.log if note["kind"] == "setting"]
    assert set(log) <= {note["message"] for note in recorded.log}
