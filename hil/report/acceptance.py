"""Acceptance of a run: the verdict that is printed last, that the exit code reports, and that campaigns count.

A run is accepted if it was completed, was not aborted, and passed all parts that its scenario requires
(``requirements.required_parts``).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hil.config.required_parts import PART_COLUMNS, required_parts
from hil.config.scenario import Requirements
from hil.loop.runner import COMPLETED


def is_accepted(completed: bool, aborted: bool, parts: Mapping[str, bool], requirements: Requirements) -> bool:
    """Return whether a run is accepted; parts: whether each was passed. A required part that was not judged fails."""
    required = required_parts(requirements.required_parts, parts)
    return completed and not aborted and bool(required) and all(parts.get(name, False) for name in required)


def parts_of(summary: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the parts of the verdict in ``summary``, that of ``hil run --json``; earlier versions have fewer."""
    found = {**summary.get("verdict", {}), **summary}
    return {name: found[name] for name in PART_COLUMNS if found.get(name) is not None}


def acceptance(summary: Mapping[str, Any], requirements: Requirements) -> dict[str, Any]:
    """Return ``accepted`` and ``required_parts`` of the JSON; summary: with ``stop`` and the parts of the verdict."""
    found = parts_of(summary)
    parts = {name: bool(part["passed"]) for name, part in found.items()}
    aborted = found.get("security", {}).get("abort") is not None
    return {
        "accepted": is_accepted(summary["stop"] == COMPLETED, aborted, parts, requirements),
        "required_parts": required_parts(requirements.required_parts, parts),
    }


def not_required_text(summary: Mapping[str, Any]) -> str:
    """Return the parts that the scenario does not require, each with its outcome, in brackets; "" without any."""
    parts = parts_of(summary)
    outcomes = [
        f"{name.replace('_', ' ')} {'ok' if part['passed'] else 'fail'}"
        for name, part in parts.items()
        if name not in summary["required_parts"]
    ]
    return f"(not required: {', '.join(outcomes)})" if outcomes else ""


def missed_parts(summary: Mapping[str, Any]) -> list[str]:
    """Return the required parts that the run did not pass."""
    parts = parts_of(summary)
    return [name for name in summary["required_parts"] if not (name in parts and parts[name]["passed"])]
