"""Result of one check."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class PreflightCheck:
    """One line of the table. passed: None for an informational result.

    value: finding with its unit. advice: remedy, "" if none is needed.
    """

    name: str
    passed: bool | None
    value: str
    advice: str = ""


def all_passed(checks: list[PreflightCheck]) -> bool:
    """Return whether no check failed; informational ones do not count."""
    return all(check.passed is not False for check in checks)
