"""Problems of settings that do not go with a part of a rig."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hil.config.load import Loaded
from hil.errors import Problem


def problems_with(part: str, loaded: Loaded[Any], wrong: Mapping[str, tuple[str, str] | None]) -> list[Problem]:
    """Return a problem for each key of ``loaded`` that does not go with ``part``.

    wrong: by the key, with the prefix ``rig.`` of a rig file, its value and what is allowed; None if it goes.
    """
    return [
        Problem(loaded.where(key.removeprefix("rig.")), key, f"{each[0]}: does not go with {part}, allowed {each[1]}")
        for key, each in wrong.items()
        if each is not None
    ]
