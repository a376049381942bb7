"""Options of pytest for a test campaign."""

from __future__ import annotations

from typing import Any, Final

import pytest

OPTIONS: Final[dict[str, dict[str, Any]]] = {
    "--rig": {"metavar": "RIG", "help": "mock, emulated (in lock-step), or a rig file; results are written"},
    "--wall-clock": {"action": "store_true", "help": "run an emulated rig by the wall clock instead of in lock-step"},
    "--resume": {"action": "store_true", "help": "continue the latest day: omit what has passed on this rig"},
    "--results": {"metavar": "DIR", "help": "folder of the results, default: a folder of this day in hil_results"},
    "--operator": {"metavar": "NAME", "help": "operator of a hardware rig; prompted for if omitted"},
    "--operator-terminal": {"metavar": "TTY", "default": "/dev/tty", "help": "terminal at the bench for confirmations"},
}


def attribute(option: str) -> str:
    """Return the attribute of the options of pytest that has the value of ``option``."""
    return f"hil_{option.strip('-').replace('-', '_')}"


def option_of(config: pytest.Config, option: str) -> Any:
    """Return the value of one of ``OPTIONS``; None without one."""
    return config.getoption(attribute(option), None)
