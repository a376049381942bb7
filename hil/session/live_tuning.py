"""Live tuning: parameters of the GNC that may change between two cycles, built from a checked scenario.

Session and replay take over the same records at the same cycle: both have the same bits.
"""

from __future__ import annotations

import base64
import lzma

import numpy as np

from hil.checks.compatibility import check_approach, check_plan
from hil.config.load import Loaded, apply_settings, check_table
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.errors import BadInput
from hil.gnc.step import GNC_PARAMS


def with_setting(scenario: Scenario, setting: str, source: str) -> Loaded[Scenario]:
    """Return ``scenario`` with ``key=value`` set, checked. Raises BadInput; source: named in its messages."""
    table = scenario.model_dump(mode="json", exclude_none=True)
    origin: dict[str, str] = {}
    apply_settings(table, [setting], Scenario, origin)
    return check_table(table, Scenario, source, dict.fromkeys(origin, source))


def check_in_flight(scenario: Loaded[Scenario], rig: Loaded[Rig]) -> None:
    """Raise BadInput if a run could not have been started with the settings of ``scenario``."""
    if problems := [*check_approach(scenario), *check_plan(scenario, rig)]:
        raise BadInput(problems)


def packed(params: np.record) -> str:
    """Return ``params`` (GNC_PARAMS) as text, to be sent between processes in one packet."""
    return base64.b64encode(lzma.compress(params.tobytes(), preset=0)).decode()


def unpacked(text: str) -> np.record:
    """Return GNC_PARAMS from a text of ``packed``. Raises ValueError for any other text."""
    try:
        data = lzma.LZMADecompressor().decompress(base64.b64decode(text, validate=True), GNC_PARAMS.itemsize + 1)
    except lzma.LZMAError as error:
        raise ValueError(f"no parameters: {error}") from error
    if len(data) != GNC_PARAMS.itemsize:
        raise ValueError(f"{len(data)} bytes of parameters, expected {GNC_PARAMS.itemsize}")
    params: np.record = np.frombuffer(data, GNC_PARAMS).view(np.recarray)[0]
    return params
