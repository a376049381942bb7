"""Option and fixtures of the contract tests."""

from __future__ import annotations

import sys

import pytest

from hil.config.load import load_rig
from hil.errors import BadInput
from tests.support import example_driver


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add --driver-rig: the drivers of a rig file on their emulators are tested besides those of this package."""
    parser.addoption("--driver-rig", help="rig file whose rails and turntable are tested too, on their emulators")


def pytest_configure(config: pytest.Config) -> None:
    """Load the rig file first: without it the tests would pass, and none would be of its drivers."""
    if (rig_file := config.getoption("--driver-rig")) is not None:
        try:
            groups = load_rig(rig_file).value.axis_groups
        except BadInput as error:
            raise pytest.UsageError(str(error)) from None
        if not any(table.has_wires for name, table in groups.items() if name != "target"):
            raise pytest.UsageError(f"--driver-rig: {rig_file}: has no axes on wires")


@pytest.fixture(scope="session", autouse=True)
def _example_driver(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Install the package of examples/driver_python for the session."""
    sys.path.insert(0, str(example_driver.install(tmp_path_factory.mktemp("site"))))
