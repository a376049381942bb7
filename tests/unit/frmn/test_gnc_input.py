"""Input of a GNC in datagrams: what is measured comes before it, to a GNC that wants it."""

from __future__ import annotations

import numpy as np

from hil.core.gnc_records import GNC_INPUT, GncMode
from hil.core.messages import new
from hil.frmn.gnc_input import MEASURED, InputReceiver, mailboxes_of


def given(cycle: int = 5, mode: GncMode = GncMode.RUNNING) -> np.record:
    """Return an input with one whole pose, one position alone, four samples and seven measurements."""
    sent = new(GNC_INPUT)
    sent.cycle, sent.mode, sent.rate_radps, sent.n_poses = cycle, mode, 0.5, 1
    sent.poses[0]["t_s"] = 0.1
    measured = sent.measured
    measured.n_samples, measured.n_poses, measured.n_measurements = 4, 2, 7
    measured.samples["rate_radps"][:4, 0] = [1.0, 2.0, 3.0, 4.0]
    measured.poses["t_s"][:2], measured.poses["status"][:2] = [0.1, 0.2], [0, 2]
    measured.measurements["number"][:7] = np.arange(7)
    return sent


def received(sent: np.record, wants: tuple[str, ...] = MEASURED, lost: tuple[int, ...] = ()) -> np.record:
    receiver = InputReceiver()
    for number, (name, record) in enumerate(mailboxes_of(sent, wants)):
        if name == "gnc.input":
            receiver.take(record)
        elif number not in lost:
            receiver.add(name, record)
    return receiver.input


def numbers(measured: np.record) -> list[int]:
    found: list[int] = measured.measurements["number"][: measured.n_measurements].tolist()
    return found


def test_all_that_is_measured_arrives() -> None:
    sent, found = given(), received(given())
    for name in ("n_samples", "n_poses", "n_measurements", "samples", "poses", "measurements"):
        assert found.measured[name].tobytes() == sent.measured[name].tobytes(), name
    assert found.rate_radps[0] == 0.5


def test_gnc_that_wants_nothing_more_receives_the_input_alone() -> None:
    assert [name for name, _ in mailboxes_of(given(), ())] == ["gnc.input"]
    measured = received(given(), ()).measured
    assert (measured.n_samples, measured.n_poses, measured.n_measurements) == (1, 1, 0)
    assert measured.samples["rate_radps"][0].tolist() == [0.5] * 3  # the mean
    assert measured.poses["t_s"][0] == 0.1


def test_lost_datagrams_are_missing_and_no_others() -> None:
    measured = received(given(), lost=(1, 3)).measured  # poses, and the second of three with measurements
    assert measured.poses["t_s"][: measured.n_poses].tolist() == [0.1]
    assert numbers(measured) == [0, 1, 2, 6]


def test_repeated_input_and_one_of_another_cycle_do_not_add_up() -> None:
    receiver = InputReceiver()
    for _ in range(2):
        for name, record in mailboxes_of(given(), MEASURED):
            if name == "gnc.input":
                receiver.take(record)
            else:
                receiver.add(name, record)
    assert numbers(receiver.input.measured) == list(range(7))
    ((_, later),) = mailboxes_of(given(6), ())
    receiver.take(later)
    assert receiver.input.measured.n_measurements == 0


def test_nothing_is_measured_in_a_hold() -> None:
    assert [name for name, _ in mailboxes_of(given(mode=GncMode.HOLD), MEASURED)] == ["gnc.input"]
    assert received(given(mode=GncMode.HOLD)).measured.n_samples == 0
