"""The command lease of the console."""

from __future__ import annotations

import pytest

from hil.parts.console.lease import Lease, RequestRejected
from hil.parts.console.live_view import Client

ANN, BOB = Client("a" * 16, "ann"), Client("b" * 16, "bob")


def held_by_ann() -> Lease:
    lease = Lease(2.0)
    lease.acquire(ANN, 10.0)
    return lease


def test_no_command_without_the_lease() -> None:
    with pytest.raises(RequestRejected, match="no operator has the command: take it before sending orders"):
        Lease(2.0).require(ANN)


def test_second_commander_is_refused_by_the_name_of_the_first() -> None:
    lease = held_by_ann()
    with pytest.raises(RequestRejected, match="ann has the command: watch, or take it over"):
        lease.acquire(BOB, 10.1)
    with pytest.raises(RequestRejected, match="ann has the command"):
        lease.require(BOB)
    lease.require(ANN)


def test_takeover_names_the_previous_holder_who_keeps_watching() -> None:
    lease = held_by_ann()
    assert lease.take_over(BOB, 10.5) == "ann"
    lease.require(BOB)
    with pytest.raises(RequestRejected, match="bob has the command"):
        lease.require(ANN)
    assert lease.take_over(BOB, 10.6) == ""


def test_lease_expires_in_silence_and_not_while_its_holder_sends() -> None:
    lease = held_by_ann()
    lease.renew(ANN, 11.5)
    assert lease.expire(13.5) == ""
    assert lease.expire(13.51) == "ann"
    assert not lease.held
    assert lease.expire(20.0) == ""
    lease.acquire(BOB, 20.0)


def test_messages_of_a_watcher_do_not_renew_the_lease() -> None:
    lease = held_by_ann()
    lease.renew(BOB, 12.0)
    assert lease.expire(12.5) == "ann"


def test_lost_holder_does_not_get_the_lease_back_by_sending() -> None:
    lease = held_by_ann()
    lease.expire(13.0)
    lease.renew(ANN, 13.1)
    with pytest.raises(RequestRejected):
        lease.require(ANN)


def test_only_the_holder_gives_the_lease_back() -> None:
    lease = held_by_ann()
    lease.release(BOB)
    assert lease.held
    lease.release(ANN)
    assert not lease.held


def test_empty_key_does_not_pass_for_the_holder_of_a_free_lease() -> None:
    with pytest.raises(RequestRejected):
        Lease(2.0).require(Client("", ""))


def test_duplicated_tab_neither_commands_nor_keeps_the_lease_alive() -> None:
    lease = held_by_ann()
    duplicate = Client(ANN.key, "ann")
    with pytest.raises(RequestRejected, match="ann has the command at another page: watch, or take it over"):
        lease.acquire(duplicate, 10.1)
    with pytest.raises(RequestRejected, match="ann has the command"):
        lease.require(duplicate)
    lease.close(ANN)
    lease.renew(duplicate, 11.9)
    with pytest.raises(RequestRejected):
        lease.require(duplicate)
    assert lease.expire(12.1) == "ann"


def test_lease_of_a_closed_page_goes_to_the_next_one_with_its_key_and_no_other() -> None:
    lease = held_by_ann()
    reloaded = Client(ANN.key, "ann")
    lease.reclaim(reloaded, 10.1)
    assert not lease.held_by(reloaded)
    lease.close(BOB)
    lease.close(ANN)
    lease.reclaim(BOB, 10.2)
    assert not lease.held_by(BOB)
    with pytest.raises(RequestRejected):
        lease.acquire(BOB, 10.3)
    lease.reclaim(reloaded, 11.5)
    lease.require(reloaded)
    with pytest.raises(RequestRejected):
        lease.require(ANN)
    assert lease.expire(13.4) == ""
