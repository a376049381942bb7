"""Orders of an operator, and the modes in which they are executed."""

from __future__ import annotations

import os
from itertools import product

import pytest

from hil.core.modes import Mode
from hil.core.operator_commands import (
    ANSWER_S,
    AutoResumeOperator,
    FreshDigits,
    JogRequest,
    Operator,
    OperatorCommand,
    TerminalOperator,
)


@pytest.mark.parametrize(("order", "mode"), list(product(OperatorCommand, Mode)))
def test_order_is_executed_in_its_modes_and_refused_with_a_message_elsewhere(
    order: OperatorCommand, mode: Mode
) -> None:
    operator = Operator((), attended=True)
    operator.submit(order)
    if mode in order.modes:
        assert operator.pop(mode) is order
        assert not operator.rejections
    else:
        assert operator.pop(mode) is None
        assert list(operator.rejections) == [f"bench: cannot {order.value} in {mode.value}"]
    assert not operator.pending


def test_plan_waits_for_its_modes_and_does_not_count_as_an_order_that_waits() -> None:
    operator = Operator()
    assert not operator.pending
    assert operator.next_command(Mode.RUNNING) is None
    assert operator.next_command(Mode.STANDBY) is OperatorCommand.HOME
    assert operator.next_command(Mode.STANDBY) is OperatorCommand.ARM
    assert operator.next_command(Mode.STANDBY) is None
    assert operator.next_command(Mode.ARMED) is OperatorCommand.START
    assert operator.next_command(Mode.ARMED) is None


def test_unattended_operator_resumes_once_from_each_hold() -> None:
    operator, modes = AutoResumeOperator(), iter((Mode.RUNNING, Mode.HOLD, Mode.HOLD))
    operator.mode = lambda: next(modes)
    operator.cancel_auto_sequence()
    for _ in range(3):
        operator.poll(0.0)
    assert operator.can_resume
    assert operator.pop(Mode.HOLD) is OperatorCommand.RESUME
    assert operator.pop(Mode.HOLD) is None


def test_dropped_plan_gives_no_orders() -> None:
    operator = Operator()
    operator.cancel_auto_sequence()
    assert operator.next_command(Mode.STANDBY) is None


def test_stop_goes_before_all_others_and_is_never_dropped() -> None:
    operator = Operator((), attended=True)
    for _ in range(200):
        operator.submit(OperatorCommand.HOLD)
    operator.submit(OperatorCommand.STOP)
    assert operator.pop(Mode.RUNNING) is OperatorCommand.STOP
    assert len(operator.pending) == 64


def test_jog_key_orders_one_jog_and_counts_each_refresh_once() -> None:
    operator = Operator((), attended=True)
    operator.jog("rails.x", 1)
    operator.jog("rails.x", 1)
    assert operator.pop(Mode.STANDBY) is OperatorCommand.JOG
    assert operator.pop(Mode.STANDBY) is None
    assert operator.jog_request() == JogRequest("rails.x", 1)
    assert operator.jog_request() is None
    operator.jog("rails.x", 1)
    assert operator.jog_request() == JogRequest("rails.x", 1)
    operator.end_jog()
    operator.jog("rails.y", -1)
    assert operator.pop(Mode.STANDBY) is OperatorCommand.JOG


def test_refused_jog_leaves_no_key_pressed() -> None:
    operator = Operator((), attended=True)
    operator.jog("rails.x", 1)
    assert operator.pop(Mode.RUNNING) is None
    assert operator.jog_request() is None
    operator.jog("rails.x", 1)
    assert operator.pop(Mode.STANDBY) is OperatorCommand.JOG


def test_operator_at_the_terminal_resumes_a_hold_by_a_typed_line_and_by_nothing_else() -> None:
    reader, writer = os.pipe()
    now_s, shown = [0.0], list[str]()
    digits = FreshDigits(lambda: now_s[0], lambda _: 27)
    operator = TerminalOperator(reader, shown.append, digits)
    operator.poll(0.0)
    assert operator.can_resume
    os.write(writer, b"resum")
    operator.poll(0.1)
    os.write(writer, b"ed\n\xff\x00[\n" + b"x" * 5000 + b"\n")
    for _ in range(40):
        operator.poll(0.2)
    assert not operator.pending
    os.write(writer, b"resume 36\nresume\n")  # typed before digits were shown
    operator.poll(0.3)
    assert not operator.pending
    assert shown[-1] == 'type "resume 38" within 5 s'
    now_s[0] = ANSWER_S + 0.1
    os.write(writer, b"resume 38\n")
    operator.poll(0.3)
    assert not operator.pending
    assert shown[-1].startswith("not resumed: the line came 5 s after the digits were shown, allowed 5 s; type")
    os.write(writer, b"resume 39\nresume 39\n")
    operator.poll(0.3)
    assert list(operator.pending) == [OperatorCommand.RESUME]
    os.write(writer, b" stop \n")
    operator.poll(0.4)
    assert operator.pending[0] is OperatorCommand.STOP
    os.close(writer)
    operator.poll(0.5)
    assert not operator.can_resume
    operator.poll(0.6)
    os.close(reader)
