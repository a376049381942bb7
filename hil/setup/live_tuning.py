"""Live tuning of the GNC: its parameter records, rebuilt from a checked scenario and exchanged between two cycles.

Session and replay use the same function at the same cycle, so both get the same bits.
"""

from __future__ import annotations

import base64
from typing import Final, NamedTuple

import numpy as np

from hil.checks.compatibility import approach_problems, flight_problems
from hil.config.load import Loaded, apply_settings, check_table
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.errors import BadInput
from hil.gnc.approach_monitor import SUPERVISION_PARAMS
from hil.gnc.control import CONTROL_PARAMS
from hil.gnc.navigation import NAVIGATION_PARAMS
from hil.params import gnc as gnc_params

_LAYOUTS: Final = (NAVIGATION_PARAMS, SUPERVISION_PARAMS, CONTROL_PARAMS)


class Tuning(NamedTuple):
    """NAVIGATION_PARAMS, SUPERVISION_PARAMS and CONTROL_PARAMS of one scenario."""

    navigation: np.record
    supervision: np.record
    control: np.record


def tuning(scenario: Scenario) -> Tuning:
    """Return the parameter records of the GNC of ``scenario``."""
    _, strength = gnc_params.allocation(scenario.chaser)
    return Tuning(
        gnc_params.navigation(scenario), gnc_params.supervision(scenario), gnc_params.control(scenario, strength)
    )


def with_setting(scenario: Scenario, setting: str, source: str) -> Loaded[Scenario]:
    """Return ``scenario`` with ``key=value`` applied, validated. Raises BadInput, which names ``source``."""
    table = scenario.model_dump(mode="json", exclude_none=True)
    origin: dict[str, str] = {}
    apply_settings(table, [setting], Scenario, origin)
    return check_table(table, Scenario, source, dict.fromkeys(origin, source))


def check_in_flight(scenario: Loaded[Scenario], rig: Loaded[Rig]) -> None:
    """Raise BadInput if a run could not have been started with the settings of this scenario."""
    if problems := [*approach_problems(scenario), *flight_problems(scenario, rig)]:
        raise BadInput(problems)


def packed(records: Tuning) -> str:
    """Return ``records`` as text, to send them to another process."""
    return base64.b64encode(b"".join(record.tobytes() for record in records)).decode()


def unpacked(text: str) -> Tuning:
    """Return the records that ``packed`` has encoded. Raises ValueError for any other text."""
    data = base64.b64decode(text, validate=True)
    sizes = [layout.itemsize for layout in _LAYOUTS]
    if len(data) != sum(sizes):
        raise ValueError(f"{len(data)} bytes of parameters, expected {sum(sizes)}")
    starts = np.cumsum([0, *sizes]).tolist()
    return Tuning(
        *(
            np.frombuffer(data, layout, 1, start).view(np.recarray)[0]
            for layout, start in zip(_LAYOUTS, starts, strict=False)
        )
    )
