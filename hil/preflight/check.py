"""What one check found."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class PreflightCheck:
    """One line of the table. passed: None for something worth knowing that fails nobody.

    value: what was found, with its unit. advice: what to do about it, "" where nothing needs to be done.
    """

    name: str
    passed: bool | None
    value: str
    advice: str = ""


def all_passed(checks: list[PreflightCheck]) -> bool:
    """Return whether no check failed; notes do not count."""
    return all(check.passed is not False for check in checks)
