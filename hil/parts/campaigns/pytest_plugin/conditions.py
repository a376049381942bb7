"""Conditions of a test: what its markers name, checked, and the digest by which a resumed day finds it unchanged."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import pytest

from hil.api.jobs import load_scenario
from hil.core.build_info import build_info
from hil.errors import BadInput, Problem
from hil.parts.campaigns.api.requirements import RunRequirement
from hil.parts.campaigns.batch import code_digest
from hil.parts.campaigns.campaign import scenario_digest

_OF_SCENARIO: Final = ("seed", "overrides", "faults", "gnc")
_DIGEST: Final = 16


@dataclass(frozen=True)
class RunConditions:
    """Scenario, seed and settings of a test. faults: replace the scenario's faults."""

    scenario: str
    seed: int = 0
    overrides: Mapping[str, Any] | None = None
    faults: Sequence[Mapping[str, Any]] | None = None
    gnc: Any = None

    @property
    def key(self) -> str:
        """Text that equal conditions share; a Python GNC is equal to itself alone."""
        return json.dumps([self.scenario, self.seed, self.overrides, self.faults, id(self.gnc)], default=str)

    @property
    def settings(self) -> dict[str, Any]:
        """Overrides with the faults among them, as ``hil.Bench`` takes them."""
        return dict(self.overrides or {}) | ({"faults": list(self.faults)} if self.faults else {})


def conditions_of(item: pytest.Item) -> RunConditions:
    """Return the conditions that the closest scenario marker of ``item`` gives, else the configuration's."""
    marker = item.get_closest_marker("scenario")
    default = str(item.config.getini("hil_scenario"))
    if marker is None:
        return RunConditions(default)
    return RunConditions(str(marker.args[0]) if marker.args else default, **marker.kwargs)


def requirements_of(item: pytest.Item) -> list[tuple[str, str, RunRequirement | None]]:
    """Return identifier, wording and, if it has one, limit of each requirement for which ``item`` is evidence."""
    requirements: list[tuple[str, str, RunRequirement | None]] = []
    document = (getattr(getattr(item, "obj", None), "__doc__", None) or item.name).strip().splitlines()[0]
    for marker in item.iter_markers("requirement"):
        for given in marker.args:
            if isinstance(given, RunRequirement):
                requirements.append((given.id, given.text, given))
            else:
                requirements.append((given, marker.kwargs.get("text", document), None))
    return requirements


def check_markers(items: Iterable[pytest.Item]) -> None:
    """Raise BadInput with a line for each marker that cannot be used."""
    problems: list[Problem] = []
    for item in items:
        for marker in item.iter_markers("requirement"):
            bad = [each for each in marker.args if not (isinstance(each, RunRequirement) or _is_id(each))]
            if bad or not marker.args:
                value = ", ".join(f"{each!r:.40}" for each in bad) or "empty"
                text = f'{value}: must be an identifier, as "RVD-021", or a hil.RunRequirement'
                problems.append(Problem(item.nodeid, "requirement", text))
        for marker in item.iter_markers("scenario"):
            unknown = [name for name in marker.kwargs if name not in _OF_SCENARIO]
            if unknown or len(marker.args) > 1:
                text = f"{', '.join(unknown) or len(marker.args)}: must be one name, with {', '.join(_OF_SCENARIO)}"
                problems.append(Problem(item.nodeid, "scenario", text))
    if problems:
        raise BadInput(problems)


def _is_id(value: object) -> bool:
    return isinstance(value, str) and bool(value.strip())


def digest_of_test(item: pytest.Item, rig_digest: str) -> str:
    """Return a digest of the test's file, its scenario with the files that it names, the rig and the program.

    Without a valid scenario it is of the rest; a Python object that flies is in it by the test's file alone.
    """
    given = conditions_of(item)
    parts = [build_info().commit, rig_digest, str(given.seed), item.nodeid]
    try:
        scenario = load_scenario(given.scenario, given.settings)
        parts += [scenario_digest(scenario), code_digest(scenario)]
    except BadInput as error:
        parts.append(str(error))
    content = hashlib.sha256("\n".join(parts).encode())
    content.update(item.path.read_bytes())
    return content.hexdigest()[:_DIGEST]
