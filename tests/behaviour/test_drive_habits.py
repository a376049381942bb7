"""Drives that do not oblige: each habit alone, combinations of them, and what no driver may make of them.

A drive either follows its setpoints, or is refused by one line before it moves.
"""

from __future__ import annotations

import math
import random
import re
from contextlib import closing

import can
import numpy as np
import pytest

from hil.config.load import load_rig
from hil.config.tables.drive_habits import DriveHabits
from hil.core.messages import Homing
from hil.drivers.turntable.cia402 import codec as codec
from hil.drivers.turntable.cia402.driver import Cia402Link
from hil.errors import DeviceError, DriveFault, LinkLost, ProtocolError
from hil.parts.emulation.cia402 import Cia402Emulator
from hil.parts.emulation.shared_state import ChainState, SharedAxisState
from tests.support.can_bus import BusClock, CanBus, group_of
from tests.support.data_sheets import altered, section
from tests.support.drive_makes import CSP_AND_HOMING, INTERPOLATED_AND_HOMING, MAKES, MILLI_PER_MINUTE, PER_MINUTE
from tests.support.lock_step import GRID_S
from tests.support.turntable_bench import error_of, eventually, served

INCREMENTAL = {"encoder": "incremental", "home_deg": 1.0, "homing_rate_degps": 15.0}
REFUSED = {
    "60 times the increments": ({"declared_scale": 60.0}, "0x608F declares 600000000 position units"),
    "a sixtieth of them": ({"declared_scale": 1.0 / 60.0}, "0x608F declares 166666.667 position units"),
    "unit that is unknown": ({"velocity_unit": 0x00010300}, "0x60A9 = 0x00010300 is no known unit"),
    "no setpoints at all": ({"supported_modes": 0x25}, "0x6502 is 0x25: the drive supports none of"),
    "not the described drive": ({"missing": (0x6007,)}, "0x6007 of the data sheet does not exist"),
    "period that it refuses": ({"aborts": (0x60C2,)}, "refuses object 0x60C2:01"),
    "reaction that it refuses": ({"aborts": (0x605A,)}, "refuses object 0x605A = 6"),
}


def move_after_homing(habits: dict, incremental: bool) -> None:
    """Home drives with ``habits`` if they need it, and move them; none is reported as homed before it is."""
    keys = INCREMENTAL if incremental else {}
    with served("cia402", cia402={"emulated": DriveHabits(**habits)}, **keys) as (emulator, device, clock):

        def none_is_homed_that_is_not():
            shown = device.read(clock.now_s()).homing
            pairs = zip(shown, emulator.gimbals.homing, strict=True)
            assert all(actual is Homing.DONE for seen, actual in pairs if seen is Homing.DONE)
            return set(shown) == {Homing.DONE}

        assert none_is_homed_that_is_not() != incremental
        if incremental:
            device.home(clock.now_s())
            eventually(clock, none_is_homed_that_is_not)
        start = device.read(clock.now_s()).position
        path = np.radians((3.0, -2.0, 1.0))
        for k in range(51):
            device.send(start + k / 50.0 * path, path / (50 * GRID_S) * (k < 50), clock.now_s())
            clock.sleep(GRID_S)
            error = np.abs(device.read(clock.now_s()).position - (start + k / 50.0 * path)).max()
            assert math.degrees(error) < 0.3
        eventually(clock, lambda: np.allclose(device.read(clock.now_s()).position, start + path, atol=1e-3))
        assert [node.touched for node in emulator.foreign_nodes] == [0] * len(emulator.foreign_nodes)


@pytest.mark.parametrize("incremental", [False, True], ids=["absolute", "incremental"])
@pytest.mark.parametrize("make", MAKES)
def test_drive_with_a_habit_homes_and_follows(make: str, incremental: bool) -> None:
    if make == "rev/min" and incremental:
        pytest.skip("15 deg/s are two of its units: covered by the drawn cases")
    move_after_homing(MAKES[make], incremental)


@pytest.mark.parametrize("case", REFUSED)
def test_drive_that_cannot_be_used_is_refused_by_one_line_before_it_moves(case: str) -> None:
    habits, text = REFUSED[case]
    seen = []
    with (
        pytest.raises(DeviceError, match=text) as caught,
        served("cia402", cia402={"emulated": DriveHabits(**habits)}, prepare=seen.append),
    ):
        pass
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("turntable.roll: ")
    assert np.abs(seen[0].gimbals.rate).max() == 0.0


def drawn(dice: random.Random) -> dict:
    """Return a combination of habits."""
    choices = {
        "mode_lag_s": dice.choice([0.0, 0.0, dice.uniform(0.0, 0.2)]),
        "mode_only_enabled": dice.random() < 0.2,
        "bits_lag_s": dice.choice([0.0, dice.uniform(0.0, 0.2)]),
        "no_remote_frames": dice.random() < 0.3,
        "velocity_unit": dice.choice([None, None, PER_MINUTE, MILLI_PER_MINUTE]),
        "declares_velocity": dice.random() < 0.8,
        "declared_scale": dice.choice([1.0] * 8 + [60.0, 1.0 / 60.0]),
        "state_lag_s": dice.choice([0.0, 0.0, dice.uniform(0.0, 0.2)]),
        "missing": tuple(index for index in (0x606C, 0x1017, 0x603F, 0x605A, 0x6007, 0x6061) if dice.random() < 0.1),
        "missing_code": dice.choice([0x06020000, 0x06010000, 0x06040043, 0x08000000]),
        "aborts": tuple(index for index in (0x1005, 0x60C2, 0x605A, 0x1016) if dice.random() < 0.1),
        "supported_modes": dice.choice([None, None, CSP_AND_HOMING, INTERPOLATED_AND_HOMING, 0x25]),
        "keeps_error": dice.random() < 0.3,
        "enable_s": dice.choice([0.0, dice.uniform(0.0, 5.0)]),
        "warnings_hz": dice.choice([0.0, dice.uniform(0.1, 10.0)]),
        "foreign_nodes": (20,) if dice.random() < 0.3 else (),
    }
    if 0x1005 in choices["aborts"]:
        choices["foreign_nodes"] = ()  # the drives have no SYNC of their own: see ``facts``
    return choices


@pytest.mark.parametrize(
    "seed", [*range(6), 154, *(pytest.param(k, marks=pytest.mark.slow) for k in range(6, 200) if k != 154)]
)
def test_drawn_combination_runs_or_is_refused_by_one_line(seed: int) -> None:
    dice = random.Random(seed)
    habits, incremental = drawn(dice), dice.random() < 0.6
    is_unusable = (
        habits["declared_scale"] != 1.0
        or habits["supported_modes"] == 0x25
        or {0x605A, 0x6007} & set(habits["missing"])
        or {0x60C2, 0x605A} & set(habits["aborts"])
        or (incremental and not habits["declares_velocity"])
    )
    if not is_unusable:
        move_after_homing(habits, incremental)
        return
    with pytest.raises(ProtocolError) as caught:
        move_after_homing(habits, incremental)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("count", [5, pytest.param(1000, marks=[pytest.mark.slow, pytest.mark.timeout(3600)])])
def test_drive_that_was_never_homed_is_never_reported_as_homed(count: int) -> None:
    dice = random.Random(402)
    for _ in range(count):
        habits = {
            "mode_lag_s": dice.uniform(0.0, 0.3),
            "bits_lag_s": dice.uniform(0.0, 0.2),
            "mode_only_enabled": dice.random() < 0.3,
            "supported_modes": dice.choice([CSP_AND_HOMING, INTERPOLATED_AND_HOMING]),
        }
        incremental = dice.random() < 0.7
        keys = {**INCREMENTAL, "homing_rate_degps": 0.1} if incremental else {}
        with served("cia402", cia402={"emulated": DriveHabits(**habits)}, **keys) as (_, device, clock):
            if incremental:
                for _ in range(2):
                    assert set(device.read(clock.now_s()).homing) == {Homing.NEEDED}, habits
                    device.close()
                    clock.sleep(dice.uniform(0.1, 0.2))
                    device.open(clock.now_s())  # the bits of the mode before linger
                device.home(clock.now_s())
                clock.sleep(1.5)
                assert Homing.DONE not in device.read(clock.now_s()).homing, habits
            else:
                assert set(device.read(clock.now_s()).homing) == {Homing.DONE}


def test_stray_statusword_is_not_confirmed_by_an_error_of_the_past() -> None:
    with served("cia402", cia402={"emulated": DriveHabits(keeps_error=True)}) as (emulator, device, clock):
        assert emulator.drives[0].objects.value(codec.ERROR_CODE) == 0x7305
        emulator._station.send([(codec.TPDO2_ID + 1, bytes.fromhex("18 02 00 00 00 00"))])  # fault, apparently
        clock.sleep(0.1)
        device.read(clock.now_s())
        assert device.counters()["protocol_errors"] == 1
        emulator._station.send(emulator.drives[0].fail(0x7500))
        clock.sleep(0.1)
        with pytest.raises(DriveFault, match="0x7500"):
            device.read(clock.now_s())


def test_drive_that_refuses_the_preferred_reaction_is_used_with_another_that_it_has() -> None:
    def preset(emulator: Cia402Emulator) -> None:
        for drive in emulator.drives:
            drive.objects.put(0x605A, 5)

    with served("cia402", cia402={"emulated": DriveHabits(aborts=(0x605A,))}, prepare=preset) as (emulator, _, _):
        assert [drive.objects.value(0x605A) for drive in emulator.drives] == [5, 5, 5]


def test_drive_that_restarts_in_mid_run_ends_it_by_its_name() -> None:
    with served("cia402") as (emulator, device, clock):
        device.read(clock.now_s())
        drive = emulator.drives[1]
        emulator._station.send(drive.on_frame(codec.NMT_ID, bytes((codec.NMT_RESET_NODE, drive.node_id)), 0.0))
        assert str(error_of(device, clock)) == "turntable.pitch: has restarted"


def test_bus_off_is_borne_for_less_than_the_time_out_and_then_named() -> None:
    with served("cia402") as (emulator, device, clock):
        start = device.read(clock.now_s()).position
        for silent in (True, False):
            (emulator.faults.on if silent else emulator.faults.off)("link_down")
            for _ in range(5 if silent else 25):
                device.send(start, 0.0 * start, clock.now_s())
                clock.sleep(GRID_S)
        assert device.counters()["lost"] > 0
        assert np.allclose(device.read(clock.now_s()).position, start, atol=1e-3)
        emulator.faults.on("link_down")
        assert re.fullmatch(r"turntable[.\w]*: no .* for .* s, allowed .* s", str(error_of(device, clock)))


def test_drives_interpolate_over_the_time_between_two_setpoints() -> None:
    written = {}
    for period_s in (0.02, 0.01, 1.0 / 30.0, 0.002):
        with served("cia402") as (emulator, device, clock):
            device.close()
            device.set_period(period_s)
            clock.sleep(0.2)
            device.open(clock.now_s())
            objects = emulator.drives[1].objects
            written[period_s] = objects.value(0x60C2, 1) * 10.0 ** objects.value(0x60C2, 2)
    assert written == pytest.approx({0.02: 0.02, 0.01: 0.01, 1.0 / 30.0: 1.0 / 30.0, 0.002: 0.004}, rel=0.01)


@pytest.mark.parametrize("missing", [(), (0x1400,)], ids=["setpoint time-out", "heartbeat"])
def test_silent_bench_is_noticed_by_the_watchdog_that_the_drive_has(missing, tmp_path) -> None:
    keys = {"eds_file": str(altered(tmp_path, (section("1400sub5"), "")))} if missing else {}
    with served("cia402", cia402=keys) as (emulator, device, clock):
        device.send(np.radians((40.0, -40.0, 40.0)), np.radians((5.0, -5.0, 5.0)), clock.now_s())
        device._link._port.send = lambda *frames: None
        eventually(clock, lambda: emulator.drives[0].state is codec.DriveState.QUICK_STOP_ACTIVE)


GUARDING = "[100C]\nDataType=0x0006\nAccessType=rw\n[100D]\nDataType=0x0005\nAccessType=rw\n\n"
LOOKALIKES = {
    "heartbeat and no event timers": ["1400sub5", "1801sub5", "6065", "6066"],
    "life guarding, no error code, own interpolation time": [
        "1400sub5",
        "1016sub1",
        "1017",
        "6007",
        "603F",
        "60C2sub1",
    ],
    "interpolated position, few objects": [
        "1400sub5",
        "6007",
        "603F",
        "605A",
        "60FD",
        "6098",
        "6099sub1",
        "60A9",
        "6084",
    ],
    "no velocities": ["606C", "60B1", "60A9", "608Fsub1"],
    "no watchdog": ["1400sub5", "1016sub1"],
}


@pytest.mark.parametrize("name", LOOKALIKES)
def test_drive_that_lacks_objects_follows_by_their_substitutes(tmp_path, name: str) -> None:
    changes = [(f"{section(index)}\n\n", "") for index in LOOKALIKES[name]]
    if "life" in name:
        changes.append(("[1016]", f"{GUARDING}[1016]"))
    habits = {"emulated": DriveHabits(supported_modes=INTERPOLATED_AND_HOMING)} if "interpolated" in name else {}
    keys = {"eds_file": str(altered(tmp_path, *changes)), **habits}
    with served("cia402", cia402=keys, timeout_s=0.4) as (emulator, device, clock):
        setups = [node.setup for node in device._link._nodes]
        expected = {"life": [codec.LIFE_GUARD], "no watchdog": []}
        watchdogs = next((each for word, each in expected.items() if word in name), None)
        if watchdogs is not None:
            assert [setup.watchdogs for setup in setups] == [watchdogs] * 3
        start, path = device.read(clock.now_s()).position, np.radians((3.0, -2.0, 1.0))
        for k in range(76):
            device.send(start + k / 75.0 * path, path / (75 * GRID_S) * (k < 75), clock.now_s())
            clock.sleep(GRID_S)
            assert np.degrees(np.abs(device.read(clock.now_s()).position - start - k / 75.0 * path).max()) < 0.3
        rates = np.degrees(device.read(clock.now_s()).rate)
        assert np.abs(rates - np.degrees(path / 1.5)).max() < 2.5
        eventually(clock, lambda: np.allclose(emulator.gimbals.position, start + path, atol=2e-3))


@pytest.mark.parametrize("seconds", [2.0, pytest.param(60.0, marks=[pytest.mark.slow, pytest.mark.timeout(600)])])
def test_two_groups_and_nodes_of_others_share_a_bus_with_a_short_queue(monkeypatch, seconds: float) -> None:
    clock = BusClock()
    bus = CanBus(clock, 500_000)
    monkeypatch.setattr(can, "Bus", bus.open)
    rig = load_rig("emulated").value.turntable
    more = dict.fromkeys(("a", "b", "c"), rig.roll)
    six = rig.model_copy(update={**more, "all_names": ("roll", "pitch", "yaw", "a", "b", "c")})
    of_bus = {"interface": "socketcan", "channel": "can0", "bitrate": 500_000}
    foreign = DriveHabits(foreign_nodes=(60, 61))
    groups = [
        group_of(six, node_ids=(1, 2, 3, 4, 5, 6), emulated=foreign, **of_bus),
        group_of(rig, node_ids=(11, 12, 13), **of_bus),
    ]
    with closing(SharedAxisState.create()) as board:
        emulators = [
            Cia402Emulator(group, clock, board, chain=lambda: ChainState(True, True, True)) for group in groups
        ]
        for emulator in emulators:
            bus.join(emulator)
        links = [Cia402Link("turntable", group, group.cia402, clock) for group in groups]
        found = [link.open() for link in links]
        lost = 0
        while clock.now_s() < seconds:
            begun_s = clock.now_s()
            for link, first in zip(links, found, strict=True):
                lost += link.exchange(first.position + 0.01 * math.sin(clock.now_s()), 0.0 * first.position) is None
            clock.sleep_until(begun_s + 0.02)
        assert lost == 0
        assert sum(interface.refused for interface in bus.interfaces) == 0
        assert [node.touched for node in emulators[0].foreign_nodes] == [0, 0]
        links[0].close()
        assert emulators[1].drives[0].operational


def test_full_queue_is_waited_for_and_a_dead_bus_is_not(monkeypatch) -> None:
    from hil.drivers.can_port import CanPort

    clock = BusClock()
    bus = CanBus(clock, 500_000)
    monkeypatch.setattr(can, "Bus", bus.open)
    of_bus = {"interface": "socketcan", "channel": "can0"}
    port = CanPort("turntable", group_of(load_rig("emulated").value.turntable, **of_bus).cia402, clock)
    port.send(*((0x201, bytes(8)) for _ in range(30)))
    assert bus.interfaces[0].refused > 0
    bus.run_until = lambda t_s: setattr(clock, "t_s", t_s)
    with pytest.raises(LinkLost, match="No buffer space available"):
        port.send(*((0x201, bytes(8)) for _ in range(30)))
