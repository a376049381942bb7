"""Faults of emulated devices: switching them by lines of text, and what they do to a wire."""

from __future__ import annotations

import json

import numpy as np
import pytest

from hil.config.tables.faults import EMULATED
from hil.parts.emulation.fault_injection import ControlPort, FaultControl, Faults, FaultyWire

PACKET = bytes(range(32))


@pytest.fixture
def faults() -> Faults:
    return Faults("rails", ("wire", "drive"), ("x", "y", "z"))


def wire(faults: Faults) -> FaultyWire:
    return FaultyWire(faults, np.random.default_rng(1))


def test_lines_switch_faults_on_and_off(faults: Faults) -> None:
    assert faults.execute("on drop 0.2") == "ok"
    assert faults.execute("on stuck y") == "ok"
    assert faults.execute("on jump z -0.05") == "ok"
    assert faults.execute("list") == "drop 0.2, stuck y 1, jump z -0.05"
    assert faults.value("drop") == 0.2
    assert faults.value("stuck", "y") == 1.0
    assert faults.value("stuck", "x") is None
    assert faults.pop("jump", "z") == -0.05
    assert faults.pop("jump", "z") is None
    assert faults.execute("off stuck y") == "ok"
    assert faults.execute("clear") == "ok"
    assert faults.execute("list") == "none"


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("on melt", ("unknown fault 'melt'", "rails", "drop", "stuck x|y|z")),
        ("on stuck", ("stuck", "give an axis", "x, y, z")),
        ("on stuck roll", ("stuck 'roll'", "x, y, z")),
        ("on drop 1.5", ("drop 1.5", "0 to 1")),
        ("on drop nan", ("drop nan",)),
        ("on delay -1", ("delay -1",)),
        ("on drop 0.1 0.2", ("0.2: too much",)),
        ("on drop much", ("much",)),
        ("on stuck y 2", ("stuck takes no number",)),
        ("", ("allowed: on FAULT",)),
        ("help", ("allowed: on FAULT", "link_down")),
    ],
)
def test_other_lines_are_refused_with_a_message_and_change_nothing(
    faults: Faults, line: str, words: tuple[str, ...]
) -> None:
    answer = faults.execute(line)
    assert answer.startswith("error: ")
    for word in words:
        assert word in answer
    assert faults.execute("list") == "none"


def test_a_wire_without_faults_changes_nothing(faults: Faults) -> None:
    assert wire(faults).passed(PACKET) == [(0.0, PACKET)]


def test_dropped_packets_have_the_given_rate(faults: Faults) -> None:
    faults.on("drop", value=0.2)
    line = wire(faults)
    arrived = sum(len(line.passed(PACKET)) for _ in range(2000))
    assert 1500 < arrived < 1700


def test_duplicates_delays_and_a_dead_wire(faults: Faults) -> None:
    line = wire(faults)
    faults.on("duplicate")
    faults.on("delay", value=0.3)
    assert line.passed(PACKET) == [(0.3, PACKET)] * 2
    faults.on("link_down")
    assert line.passed(PACKET) == []


def test_corrupted_packets_keep_their_length_and_differ_in_a_few_bits(faults: Faults) -> None:
    faults.on("corrupt")
    line = wire(faults)
    flips = []
    for _ in range(200):
        ((_, damaged),) = line.passed(PACKET)
        assert len(damaged) == len(PACKET)
        flips.append(sum((a ^ b).bit_count() for a, b in zip(damaged, PACKET, strict=True)))
    assert max(flips) <= 3
    assert np.mean(np.array(flips) > 0) > 0.95
    assert line.passed(b"") == [(0.0, b"")]


def test_the_control_port_answers_each_line(faults: Faults) -> None:
    port = ControlPort(faults)
    control = FaultControl(port.address)
    try:
        assert control.send("on stuck x") == "ok"
        assert faults.value("stuck", "x") == 1.0
        with pytest.raises(ValueError, match="unknown fault 'melt'"):
            control.send("on melt")
        assert control.send("list") == "stuck x 1"
    finally:
        control.close()
        port.close()
    with pytest.raises(OSError, match="refused"):
        FaultControl(port.address)


def test_kinds_list_for_programs_what_can_be_switched_on() -> None:
    faults = Faults("rails", ("wire", "drive"), ("x", "y"))
    told = json.loads(faults.execute("kinds"))
    assert told["axes"] == ["x", "y"]
    assert list(told["kinds"]) == [*EMULATED["wire"], *EMULATED["drive"]]
    assert told["kinds"]["drop"]["value"] == "share"
    assert told["kinds"]["stuck"]["of_axis"]
