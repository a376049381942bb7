"""Option and fixtures of the contract tests."""

from __future__ import annotations

import sys

import pytest

from tests.support import example_driver


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add --driver-rig: the drivers of a rig file on their emulators are tested besides those of this package."""
    parser.addoption("--driver-rig", help="rig file whose rails and turntable are tested too, on their emulators")


@pytest.fixture(scope="session", autouse=True)
def _example_driver(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Install the package of examples/driver_python for the session."""
    sys.path.insert(0, str(example_driver.install(tmp_path_factory.mktemp("site"))))
