"""CITATION.cff names the version of the program."""

from pathlib import Path

import yaml

from hil.core.build_info import VERSION

ROOT = Path(__file__).resolve().parents[2]


def test_citation_has_the_version_of_the_program() -> None:
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert cited["version"] == VERSION
    assert {"cff-version", "message", "title", "authors"} <= set(cited)
