"""Scenarios of the tests of the filters."""

from __future__ import annotations

import pytest

from hil.config.load import load_scenario
from hil.config.scenario import Scenario
from tests.support.plain_filters import PLAIN


@pytest.fixture(scope="session")
def plain_filters_1() -> Scenario:
    """Return scheme-1 with the filters of the bench paper: without error budget and commanded thrust."""
    return load_scenario("scheme-1", PLAIN).value


@pytest.fixture(scope="session")
def plain_filters_2() -> Scenario:
    """Return scheme-2 with the filters of the bench paper: without error budget and commanded thrust."""
    return load_scenario("scheme-2", PLAIN).value
