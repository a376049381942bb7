"""Management messages of ptp4l, and what is made of its state."""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from hil.config.load import load_rig, load_scenario
from hil.drivers.ptp import PtpStatus, data_of, read_status, request
from hil.errors import BadInput, LinkLost, LinkTimeout
from hil.parts.wires.devices import check_clock, ptp_check
from hil.parts.wires.meters import ClockWatch
from hil.report.table import _clocks_text

TRANSCRIPT = bytes.fromhex(  # response of ptp4l 3.1.1 to GET TIME_STATUS_NP: offset -45 ns, with a master
    "0d020068000000000000000000000000000000004a6fc0fffe3224cb0000000004" "7f" "68696c62656e636800010000" "0200"
    "00010034c000" "ffffffffffffffd3" "18eaa5a9b8b1a2c7" "00000000" "00000000" "0000" "000000000000000000000000"
    "00000001" "ee0590fffe2e5fbf"
)  # fmt: skip


class Daemon:
    """Answers requests like ptp4l, with a given port state and offset."""

    def __init__(self, path: Path, state: int, offset_ns: int, master: bool) -> None:
        self.path = str(path)
        self._data = {
            0x2004: bytes(10) + bytes([state]) + bytes(15),
            0xC000: struct.pack(
                ">qqiiH12si8s", offset_ns, 0, 0, 0, 0, bytes(12), int(master), b"\xee\x05\x90\xff\xfe\x2e\x5f\xbf"
            ),
            0x2001: struct.pack(">Hqq", 1, 0, 2148 << 16),
        }
        self._link = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._link.bind(self.path)
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        while True:
            asked, client = self._link.recvfrom(2048)
            if not asked:
                return
            what = struct.unpack_from(">H", asked, 52)[0]
            answer = bytearray(request(0, what))
            answer[46] = 2  # RESPONSE
            answer[54:] = self._data[what]
            self._link.sendto(b"\x00" * 60, client)  # something else first
            self._link.sendto(bytes(answer), client)

    def close(self) -> None:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as last:
            last.sendto(b"", self.path)
        self._thread.join()
        self._link.close()


@pytest.fixture
def daemon(tmp_path: Path) -> Iterator[Daemon]:
    daemon = Daemon(tmp_path / "ptp4l", 9, 1500, True)
    yield daemon
    daemon.close()


def limited(path: str, limit_us: float) -> tuple[str, str]:
    return f'rig.clock.ptp_socket="{path}"', f"rig.clock.ptp_max_offset_us={limit_us}"


def test_a_recorded_response_is_read() -> None:
    data = data_of(TRANSCRIPT, 0xC000)
    assert data is not None
    assert struct.unpack_from(">q", data) == (-45,)
    assert data_of(TRANSCRIPT, 0x2004) is None
    assert data_of(TRANSCRIPT[:60], 0xC000) is None


def test_state_offset_and_delay_are_read_from_the_socket(daemon: Daemon) -> None:
    found = read_status(daemon.path)
    assert (found.state, found.grandmaster) == ("slave", "ee0590fffe2e5fbf")
    assert found.offset_s == pytest.approx(1.5e-6)
    assert found.path_delay_s == pytest.approx(2.148e-6)
    clocks = ClockWatch(load_rig("emulated", limited(daemon.path, 2.0)).value.clock).numbers()
    assert clocks["ptp"]["begin"] == clocks["ptp"]["end"] == found.as_json()
    assert "PTP slave, offset 1.5 and 1.5 us at begin and end; system time" in _clocks_text(clocks, {})


def test_a_run_is_refused_beyond_the_limit_and_accepted_within_it(daemon: Daemon) -> None:
    assert check_clock(load_scenario("scheme-1"), load_rig("emulated", limited(daemon.path, 2.0))) == []
    (problem,) = check_clock(load_scenario("scheme-1"), load_rig("emulated", limited(daemon.path, 1.0)))
    assert "rig.clock.ptp_max_offset_us: 1: slave, offset 1.5 us, allowed 1 us" in str(problem)
    assert check_clock(load_scenario("scheme-1"), load_rig("mock", limited(daemon.path, 1.0))) == []  # simulated time
    assert ptp_check(load_rig("emulated", limited(daemon.path, 2.0)).value.clock).passed is True
    assert ptp_check(load_rig("emulated", limited(daemon.path, 1.0)).value.clock).passed is False


def test_a_clock_without_ptp_is_a_note_unless_a_limit_is_set(tmp_path: Path) -> None:
    absent = str(tmp_path / "absent")
    assert ptp_check(load_rig("emulated", (f'rig.clock.ptp_socket="{absent}"',)).value.clock).passed is None
    (problem,) = check_clock(load_scenario("scheme-1"), load_rig("emulated", limited(absent, 1.0)))
    assert "ptp4l: cannot open" in str(problem)
    with pytest.raises(LinkLost):
        read_status(absent)


def test_a_daemon_that_does_not_answer_is_named(tmp_path: Path) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as silent:
        silent.bind(str(tmp_path / "ptp4l"))
        with pytest.raises(LinkTimeout, match="ptp4l: no answer at"):
            read_status(str(tmp_path / "ptp4l"))


def test_a_port_without_master_is_not_synchronised_and_a_master_is() -> None:
    assert PtpStatus("listening", 0.0, 0.0, "").problem(1.0) == "listening, no master"
    assert PtpStatus("master", 0.0, 0.0, "").problem(1e-9) == ""
    assert [str(PtpStatus(state, 2e-6, 0.0, "")) for state in ("listening", "master")] == ["listening", "master"]
    assert str(PtpStatus("slave", 2e-6, 0.0, "ee05")) == "slave of ee05, offset 2 us"


@pytest.mark.parametrize("setting", ["ptp_max_offset_us=0", "ptp_max_offset_us=-1.0", "ptp_domain=200", "ptp=1"])
def test_bad_keys_are_refused(setting: str) -> None:
    with pytest.raises(BadInput) as raised:
        load_rig("emulated", (f"rig.clock.{setting}",))
    assert len(raised.value.problems) == 1
