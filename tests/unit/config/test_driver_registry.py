"""Registry of drivers: what a rig file can select, drivers of other packages, and the line that each fault gives."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from hil.config.load import load_rig
from hil.config.rig import Rig
from hil.config.tables import driver_registry
from hil.config.tables.driver_registry import driver_entry
from hil.errors import BadInput

ENTRY = """
from hil.config.tables.driver_registry import DriverEntry, WireKey
from hil.config.tables.model import ConfigModel

class Settings(ConfigModel):
    port: str | None = None
    baud: int = 9600

ENTRY = DriverEntry("rails", "acme", driver="acme:Driver", settings=Settings, wires=[WireKey("acme.port", "serial")])
"""
Install = Callable[..., None]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Install a package with one module and one entry point, as pip lays it out."""

    def install(source: str = ENTRY, point: str = "rails.acme = {module}:ENTRY", package: str = "acme_rails") -> None:
        folder = tmp_path / package
        info = folder / f"{package}-1.2.dist-info"
        info.mkdir(parents=True)
        (folder / f"{package}.py").write_text(source)
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.2\n")
        (info / "entry_points.txt").write_text(f"[hil.drivers]\n{point.format(module=package)}\n")
        monkeypatch.syspath_prepend(str(folder))

    yield install
    driver_entry.cache_clear()
    sys.modules.pop("acme_rails", None)


def refusal(*settings: str) -> str:
    """Return the one line with which the emulated rig is refused."""
    with pytest.raises(BadInput) as caught:
        load_rig("emulated", settings)
    (problem,) = caught.value.problems
    return str(problem)


def test_every_driver_of_this_package_is_described_under_its_own_name() -> None:
    for key in driver_registry._BUILT_IN:
        entry = driver_entry(*key.split("."))
        assert f"{entry.device}.{entry.name}" == key
        assert driver_registry._imported(entry.driver)
        assert entry.emulator is None or driver_registry._imported(entry.emulator)


def test_unknown_driver_lists_the_known_ones_with_their_source(install: Install) -> None:
    install()
    assert refusal("rig.rails.driver=acne") == (
        '--set: rig.rails.driver: "acne": unknown rails driver, known: mock, modbus, modbus_rtu, arm (hil), '
        "acme (acme_rails 1.2); an entry point that was added to a package is seen when pip has installed it again"
    )


def test_driver_of_another_package_brings_its_own_table_and_wires(install: Install) -> None:
    install()
    rig = load_rig("emulated", ["rig.rails.driver=acme", "rig.rails.acme.port=/dev/ttyACM0"]).value
    assert (rig.rails.settings.port, rig.rails.settings.baud) == ("/dev/ttyACM0", 9600)
    assert [(wire.key, wire.kind, wire.address) for wire in rig.rails.wires("rails")] == [
        ("rails.acme.port", "serial", "/dev/ttyACM0")
    ]
    assert Rig.model_validate(rig.model_dump(mode="json"), strict=False) == rig


def test_driver_of_another_package_has_a_table_without_being_given_one(install: Install) -> None:
    install()
    rails = load_rig("emulated", ["rig.rails.driver=acme"]).value.rails
    assert rails.settings.port is None
    assert rails.connected("rails", {"rails": "/dev/pts/7"}).settings.port == "/dev/pts/7"


@pytest.mark.parametrize(
    ("setting", "line"),
    [
        ("rig.rails.acme.baud=fast", '--set: rig.rails.acme.baud: "fast": must be a valid integer'),
        (
            "rig.rails.acme.bauds=1",
            "--set: rig.rails.acme.bauds: unknown key: did you mean baud? known here: baud, port",
        ),
    ],
)
def test_settings_are_validated_by_the_model_of_their_driver(install: Install, setting: str, line: str) -> None:
    install()
    assert refusal("rig.rails.driver=acme", setting) == line


def test_unknown_key_of_a_device_is_reported_with_its_other_faults() -> None:
    with pytest.raises(BadInput) as caught:
        load_rig("emulated", ["rig.rails.timeout=1", "rig.rails.timeout_s=-1"])
    assert sorted(str(problem) for problem in caught.value.problems) == [
        "--set: rig.rails.timeout: unknown key: the unit is part of the name, here it is timeout_s",
        "--set: rig.rails.timeout_s: -1: must be greater than 0",
    ]


@pytest.mark.parametrize(
    ("source", "point", "line"),
    [
        (
            "import serial_of_acme",
            "rails.acme = {module}:ENTRY",
            "acme_rails:ENTRY cannot be imported: ModuleNotFoundError: No module named 'serial_of_acme'",
        ),
        ("ENTRY = 3", "rails.acme = {module}:ENTRY", "acme_rails:ENTRY is of type int, expected DriverEntry"),
        (
            ENTRY.replace('"acme", driver', '"acne", driver'),
            "rails.acme = {module}:ENTRY",
            "acme_rails:ENTRY is the entry of rails.acne, expected rails.acme",
        ),
    ],
)
def test_unusable_entry_point_names_its_package_and_the_cause(
    install: Install, source: str, point: str, line: str
) -> None:
    install(source, point)
    found = refusal("rig.rails.driver=acme")
    assert found == f'--set: rig.rails.driver: "acme": rails driver of package acme_rails 1.2: {line}'
    assert load_rig("emulated").value.rails.driver == "modbus"  # other rigs are not affected


def test_two_packages_with_the_same_driver_are_an_error(install: Install) -> None:
    install()
    install(package="acme_other")
    assert refusal("rig.rails.driver=acme") == (
        '--set: rig.rails.driver: "acme": rails driver of several packages: acme_other 1.2, acme_rails 1.2'
    )
