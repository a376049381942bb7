"""Alarms name device, value and limit; the book latches them. Lost packets: single ones pass, bursts do not."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import pytest

from hil.config.load import load_scenario
from hil.core import alarm_table as table
from hil.core.alarm_table import alarm_from_error
from hil.core.alarms import LOW, MEDIUM, Alarm
from hil.errors import BenchError, DriveFault, LinkLost, LinkTimeout, ProtocolError
from hil.safety.alarms import AlarmLog
from hil.safety.condition_alarms import HealthAlarms
from hil.safety.packet_loss import LeakyBucket, LinkWatch

FOLLOWING = table.FOLLOWING_ERROR.alarm(1.5, "rails.x", 0.0612, 0.05)


def test_text_names_device_value_and_limit_and_is_that_of_the_trip() -> None:
    assert FOLLOWING.text == "rails.x: following error 0.0612 m, allowed 0.05 m"
    assert str(FOLLOWING.trip()) == FOLLOWING.text


@pytest.mark.parametrize(
    ("alarm", "text", "numbers"),
    [
        (FOLLOWING, "following error 0.0612 m, allowed 0.05 m", ("following_error", 0.0612, 0.05, "m")),
        (
            table.SPEED.alarm(0.0, "yaw", math.radians(3.0), math.radians(1.0), rotates=True),
            "speed 3.00 deg/s reported, allowed 1.00 deg/s by its position",
            ("speed", math.radians(3.0), math.radians(1.0), "rad/s"),
        ),
        (
            table.POSITION.alarm(0.0, "x", -1.25, (-1.2, 1.2)),
            "position -1.2500 m, allowed -1.2 m to 1.2 m",
            ("position", -1.25, -1.2, "m"),
        ),
        (
            table.INTERLOCK.alarm(0.0, "io", "open", "closed", "door"),
            "interlock door open, allowed closed",
            ("interlock", None, None, ""),
        ),
        (table.RATE.alarm(0.0, "x", "nan", "a finite number"), "rate nan, allowed a finite number",
         ("rate", None, None, "")),
    ],
    ids=lambda each: each.code if isinstance(each, Alarm) else None,
)  # fmt: skip
def test_alarm_has_its_numbers_in_si_and_their_text(alarm: Alarm, text: str, numbers: tuple[object, ...]) -> None:
    assert alarm.text == f"{alarm.device}: {text}"
    assert (alarm.code, alarm.measured, alarm.allowed, alarm.unit) == numbers


@pytest.mark.parametrize(
    ("error", "quantity"),
    [
        (FOLLOWING.trip(), "following error"),
        (LinkLost("rails.x", "connection closed"), "link"),
        (LinkTimeout("rails.x", "no answer for 0.5 s, allowed 0.4 s"), "timeout"),
        (ProtocolError("rails.x", "CRC 0x1a2b, expected 0x1a2c"), "protocol"),
        (DriveFault("rails.x", "reports fault 0x05"), "drive fault"),
    ],
)
def test_every_device_error_becomes_an_alarm_with_its_own_text(error: BenchError, quantity: str) -> None:
    alarm = alarm_from_error(error, 2.0)
    assert (alarm.t_s, alarm.device, alarm.quantity, alarm.text) == (2.0, "rails.x", quantity, str(error))
    assert alarm.value
    assert alarm.limit
    assert alarm.latched
    assert not alarm.acknowledged
    assert json.loads(json.dumps(alarm.as_json()))["device"] == "rails.x"


def test_book_latches_acknowledges_and_lets_go_by_reset_alone() -> None:
    book = AlarmLog()
    first = book.latch(FOLLOWING)
    assert book.latch(replace(FOLLOWING, t_s=9.0, value="1 m")) == first  # does not bury the first
    book.latch(replace(FOLLOWING, device="rails.y"))
    assert [alarm.device for alarm in book.latched()] == ["rails.x", "rails.y"]
    assert book.acknowledge() == 2
    assert book.acknowledge() == 0
    assert len(book.latched()) == 2  # seen, but still there
    book.reset()
    assert not book.latched()
    assert [(alarm.latched, alarm.acknowledged) for alarm in book.all()] == [(False, True)] * 2
    book.latch(FOLLOWING)
    assert len(book.all()) == 3
    assert len(book.latched()) == 1


DISAGREES = table.NAVIGATION_POSE.alarm(3.0, "monitor", 0.12, 0.03)


def test_condition_stands_until_it_is_acknowledged_and_returns_to_normal() -> None:
    book = AlarmLog()
    book.raise_condition(DISAGREES)
    book.raise_condition(DISAGREES)
    (alarm,) = book.latched()
    assert (alarm.number, alarm.active, alarm.acknowledged) == (1, True, False)
    book.return_to_normal("monitor", DISAGREES.quantity)
    (alarm,) = book.latched()
    assert not alarm.active  # normal again, and not read yet
    book.raise_condition(DISAGREES)
    assert len(book.all()) == 1
    assert book.latched()[0].active
    book.acknowledge(by="ann")
    assert book.latched()[0].acknowledged_by == "ann"  # it lasts
    book.return_to_normal("monitor", DISAGREES.quantity)
    assert not book.latched()
    book.raise_condition(DISAGREES)
    assert [alarm.number for alarm in book.all()] == [1, 2]


def test_each_alarm_is_acknowledged_by_itself_and_trips_come_first() -> None:
    book = AlarmLog()
    book.raise_condition(DISAGREES)
    book.latch(FOLLOWING)
    assert [alarm.number for alarm in book.all()] == [2, 1]
    assert book.acknowledge(2, "ann") == 1
    assert [(alarm.number, alarm.acknowledged) for alarm in book.all()] == [(2, True), (1, False)]


def test_conditions_can_be_shelved_for_a_time_and_trips_cannot() -> None:
    book = AlarmLog()
    book.raise_condition(DISAGREES)
    book.latch(FOLLOWING)
    assert book.shelve(2, 10.0, 60.0) == "alarm 2: of high priority, which cannot be shelved"
    assert book.shelve(7, 10.0, 60.0) == "alarm 7: does not stand"
    assert book.shelve(1, 10.0, 1e9) == "1e+09 s: allowed 0 to 3600 s"
    assert book.shelve(1, 10.0, 60.0, "ann") == ""
    book.poll(69.9)
    assert book.all()[1].shelved_until_s == 70.0
    book.poll(70.0)
    assert book.all()[1].shelved_until_s == 0.0
    assert book.shelve(1, 80.0, 60.0) == ""
    assert book.shelve(1, 81.0, 0.0, "bob") == ""
    texts = [text for _, text in book.changes]
    assert texts == ["shelved for 60 s by ann", "unshelved: its time is over", "shelved for 60 s", "unshelved by bob"]


def test_bits_of_the_health_are_conditions_that_name_the_device() -> None:
    book = AlarmLog()
    kinds = ("approach", "hold", "wait", "final", "retreat")
    scenario = load_scenario("scheme-1", tuple(f"gnc.reactions.thruster_fault.{kind}=continue" for kind in kinds))
    off = table.NAVIGATION_POSE.alarm(0.0, "monitor", 0.1234, 0.03, notes=(" along the line of sight", ""))
    health = HealthAlarms(book, scenario.value, lambda: off)
    for bench_s, bits in ((1.0, 0), (2.0, 16), (3.0, 16), (4.0, 24), (5.0, 8), (6.0, 0)):
        health.update(bench_s, bits)
    first, second = book.all()
    assert first.text == "monitor: pose of the navigation off by 0.1234 m along the line of sight, allowed 0.0300 m"
    assert (first.t_s, first.priority, first.active) == (2.0, MEDIUM, False)
    assert (second.device, second.t_s, second.priority, second.active) == ("thrusters", 4.0, LOW, False)


def test_single_lost_packets_are_forgiven_for_ever() -> None:
    bucket = LeakyBucket(capacity=3.0, forget_s=1.0)
    assert not any(bucket.add(1, 1.1 * k) for k in range(10_000))


def test_a_burst_trips_and_its_size_is_what_is_allowed_at_once() -> None:
    bucket = LeakyBucket(capacity=3.0, forget_s=1.0)
    assert [bucket.add(1, 0.0) for _ in range(5)] == [False, False, False, True, True]
    assert not bucket.add(0, 4.0)
    assert bucket.level == pytest.approx(1.0)


def test_losses_that_come_faster_than_they_are_forgiven_trip_in_the_end() -> None:
    bucket = LeakyBucket(capacity=3.0, forget_s=1.0)
    tripped = next(k for k in range(100) if bucket.add(1, 0.5 * k))
    assert tripped == 5  # the level rises by a half each 0.5 s from 1


def test_time_that_runs_backwards_forgives_nothing() -> None:
    bucket = LeakyBucket(capacity=3.0, forget_s=1.0)
    bucket.add(3, 5.0)
    bucket.add(0, 1.0)
    assert bucket.level == 3.0
    bucket.add(0, 6.0)
    assert bucket.level == pytest.approx(2.0)


def test_link_watch_counts_what_is_new_and_names_the_device() -> None:
    lost = [7]
    watch = LinkWatch("vmu", LeakyBucket(2.0, 1.0), lambda: lost[0])
    watch.restart()
    assert watch.check(0.0) is None  # what was lost before the link was opened does not count
    lost[0] = 9
    assert watch.check(0.1) is None
    lost[0] = 0  # the device restarted its count
    assert watch.check(0.2) is None
    lost[0] = 2
    alarm = watch.check(0.2)
    assert alarm is not None
    assert alarm.text == "vmu: lost packets 3.9, allowed 2 at once, 1 per 1 s"
    watch.restart()
    assert watch.check(0.3) is None


def test_an_excluded_sensor_is_named_also_once_it_is_used_again() -> None:
    book, suspects = AlarmLog(), ["sensor.lidar"]
    health = HealthAlarms(book, load_scenario("scheme-1").value, suspect=lambda: suspects[0])
    health.update(1.0, 128)
    suspects[0] = ""
    health.update(2.0, 0)
    (alarm,) = book.all()
    assert (alarm.device, alarm.active) == ("sensor.lidar", False)
