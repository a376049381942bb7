"""All checks of a preflight, in their order."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hil.checks.compatibility import approach_problems, flight_problems
from hil.checks.truth import truth_problems
from hil.config.load import Loaded
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.preflight.check import PreflightCheck, all_passed
from hil.preflight.devices import rig_checks
from hil.preflight.host import HostFacts, host_checks, probe_host
from hil.preflight.lateness import Lateness, lateness_check, measure

Probe = Callable[[Path], HostFacts]
Meter = Callable[[float], Lateness]


@dataclass(frozen=True, slots=True)
class Preflight:
    """What was found; ``lateness`` is None where it could not be measured."""

    checks: list[PreflightCheck]
    lateness: Lateness | None
    rate_hz: float

    @property
    def passed(self) -> bool:
        return all_passed(self.checks)

    def numbers(self) -> dict[str, Any]:
        """Return everything as it goes into JSON."""
        late = self.lateness
        return {
            "passed": self.passed,
            "rate_hz": self.rate_hz,
            "lateness_us": late.percentiles_us if late else None,
            "lateness_histogram": [{**b, "up_to_us": b["below_us"]} for b in late.histogram] if late else None,
            "checks": [{"name": c.name, "passed": c.passed, "value": c.value, "advice": c.advice} for c in self.checks],
        }


def preflight(
    scenario: Loaded[Scenario],
    rig: Loaded[Rig],
    folder: Path,
    enable_drives: bool,
    announce: Callable[[str], None] = lambda _: None,
    probe: Probe = probe_host,
    meter: Meter = measure,
) -> Preflight:
    """Return what all checks found.

    folder: where runs are written. announce: told what is being looked at. probe, meter: how the host is asked
    and its lateness measured.
    """
    flown = scenario.value
    announce("asking the operating system")
    cycles = round(flown.duration_s / flown.step_s) + 1
    checks = host_checks(probe(folder), cycles, rig.value.kind == "hardware")
    announce("following the plan of the scenario")
    checks.append(reach_check(scenario, rig))
    announce("opening the devices")
    checks += rig_checks(flown, rig.value, enable_drives)
    announce("measuring the lateness")
    try:
        late = meter(flown.step_s)
    except RuntimeError as error:
        return Preflight([*checks, PreflightCheck("lateness", False, str(error))], None, 1.0 / flown.step_s)
    return Preflight([*checks, lateness_check(late)], late, 1.0 / flown.step_s)


def reach_check(scenario: Loaded[Scenario], rig: Loaded[Rig]) -> PreflightCheck:
    """Return whether the rig can follow the plan of the scenario."""
    problems = truth_problems(scenario) or [*flight_problems(scenario, rig), *approach_problems(scenario)]
    name = f"reach of {scenario.value.name}"
    if not problems:
        return PreflightCheck(
            name, True, "travel, speed, acceleration, gimbals and view suit the plan with its dispersion"
        )
    told = "; ".join(str(problem) for problem in problems)
    return PreflightCheck(name, False, told, "change the scenario's key or the rig's limit that is named")
