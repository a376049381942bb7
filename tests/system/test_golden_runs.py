"""Runs, campaigns and replays of the shipped scenarios keep their bits."""

from __future__ import annotations

import json
from collections.abc import Callable

import pytest

from tests.support.golden_runs import FILE, cases, platform_of_the_bits

pytestmark = pytest.mark.xdist_group("campaign")

_GOLDEN = json.loads(FILE.read_text())


@pytest.mark.skipif(_GOLDEN["platform"] != platform_of_the_bits(), reason="the digests are those of another platform")
@pytest.mark.parametrize(("name", "digest"), [pytest.param(name, digest, id=name) for name, digest in cases()])
def test_bits_are_those_of_before(name: str, digest: Callable[[], str]) -> None:
    assert digest() == _GOLDEN["digests"][name], "python -m tests.support.golden_runs writes the new ones"


def test_file_has_every_case_and_no_other() -> None:
    assert list(_GOLDEN["digests"]) == [name for name, _ in cases()]
