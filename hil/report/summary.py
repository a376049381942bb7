"""Key numbers of a run, with the keys of ``hil run --json``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from hil.checks.compatibility import sign_off_gap
from hil.checks.ephemeris import ephemeris_warnings
from hil.checks.waivers import waivers
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.config.tables.faults import TimedFault
from hil.config.tables.sign_off import SignOff
from hil.core.alarm_table import ALARMS
from hil.core.build_info import build_info
from hil.core.messages import Event
from hil.gnc.control import rule_of
from hil.gnc_backends.approach_events import DOCKING_GO
from hil.gnc_backends.backend_registry import backend_file, digest_of
from hil.loop.outcome import Outcome
from hil.loop.runner import COMPLETED
from hil.params import gnc as gnc_params
from hil.params.ready import ROW_NAMES
from hil.report.integrity import SafeStop, decision_part, detection, integrity_part
from hil.report.limits import RunNumbers, alarms_before, first_violated, margins_of, stop_of_alarm
from hil.report.results import RmsMax, RunResults
from hil.report.tally import Tallied, Tally
from hil.report.verdict import Verdict, acceptance

if TYPE_CHECKING:
    from hil.recording.read import Recorded


BROKE_OFF: Final = "the recording broke off"


def summarise(
    outcome: Outcome,
    scenario: Scenario,
    rig: Rig,
    rig_name: str,
    seed: int,
    rate_hz: float,
    numbers: Tallied | None = None,
    ephemeris: list[str] | None = None,
) -> tuple[dict[str, Any], Verdict]:
    """Return the run's results as JSON content, and the verdict; None for quantities that the run did not reach.

    numbers: of ``Tally``, if ``outcome.history`` has the last rows of a long run only. ephemeris: of ``before_run`` for
    the whole run; judged again without it, and for a run that has not been completed.
    """
    history = outcome.history
    if numbers is None:
        tally = Tally(scenario, rig)
        tally.add(history)
        numbers = tally.numbers()
    results, stats, verdict = numbers
    aborted = bool(len(history) and history["supervision"]["aborted"][-1])
    passed = verdict.passed and outcome.stop == COMPLETED and not aborted
    measured = outcome.measured
    results.bench.limited_cycles = outcome.limited_cycles
    if ephemeris is None or outcome.stop != COMPLETED:
        ephemeris = ephemeris_warnings(scenario, rig, (int(stats.cycles) - 1) * scenario.step_s, seed)
    for name, error in measured.get("bench", {}).items():
        setattr(results.bench, name, RmsMax.of(error))
    for name, rate_hz_of in measured.get("exchanges", {}).items():
        getattr(results.timing.devices, name).exchange_hz = rate_hz_of
    results = replace(
        results,
        scenario=scenario.name,
        build=build_info()._asdict(),
        seed=seed,
        rig=rig_name,
        passed=passed,
        stop=outcome.stop,
        ready_time_s=verdict.ready_time_s,
        held_since_s=verdict.held_since_s,
        ready_phase={name: verdict.worst[name].tolist() for name in ROW_NAMES} if verdict.worst else None,
        integrity=integrity_part(stats.integrity, scenario),
        decision=decision_part(stats.integrity, scenario),
        docking_go_s=docking_go_s(outcome.events),
        control=control_numbers(history, scenario),
        gnc=gnc_summary(scenario),
        orbit=results.orbit | {"ephemeris": ephemeris[0] if ephemeris else None},
        vision=outcome.vision_counters,
        drift_check=measured.get("drift_check") or None,
        timing=replace(
            results.timing,
            rate_hz=rate_hz,
            axes_rate_hz=rate_hz * rig.ticks(scenario.step_s),
            imu_rate_hz=rate_hz * scenario.imu_samples,
            overruns=outcome.overruns,
            skipped_periods=outcome.skipped_periods,
            late_cycle=rig.on_overrun,
            privileges=[{"name": g.name, "granted": g.granted, "detail": g.detail} for g in outcome.privileges],
        ),
        clocks=measured.get("clocks"),
        truth=measured.get("truth"),
        manipulator=measured.get("manipulator"),
        held_axes=measured.get("held_axes"),
        sensors=measured.get("sensors"),
        imu=measured.get("imu"),
        sign_off=sign_off_summary(rig),
        waived=[waiver.as_json() for waiver in waivers(rig, scenario)],
        events=[{"t_s": event.t_s, "source": event.source, "text": event.text} for event in outcome.events],
        injected=[
            injected(fault, detection(stats.integrity, k, fault, safe_stop(outcome, scenario)))
            for k, fault in enumerate(scenario.faults)
        ],
        faults=outcome.faults,
        alarms=[alarm.as_json() for alarm in outcome.alarms],
    )
    results.passed_all_parts = passed and all(part.passed for part in results.parts().values())
    results.accepted, results.required_parts = acceptance(results, scenario.requirements)
    return results.as_json() | limits_of(outcome, stats, results, scenario), verdict


def limits_of(outcome: Outcome, stats: np.record, results: RunResults, scenario: Scenario) -> dict[str, Any]:
    """Return the first violated limit, the alarms before it and the margins. stats: RUN_STATS."""
    view, end_s, stop = results.verdict.field_of_view, 0.0, None
    if len(outcome.history):
        end_s = float(outcome.history["t_s"][-1])
    if outcome.stop != COMPLETED:
        alarm = next((alarm for alarm in outcome.alarms if alarm.text == outcome.stop), None)
        stop = stop_of_alarm(alarm, outcome.stop, end_s)
    parts = {name: bool(part.passed) for name, part in results.parts().items()}
    seen, measured = (view.margin_px, view.at_s, view.at_s), outcome.measured.get("limits", {})
    run = RunNumbers(stats, parts, seen, results.verdict.energy, end_s, bool(results.accepted), stop, measured)
    margins = margins_of(run, scenario)
    first = first_violated(run, scenario, margins)
    return first | {
        "alarms_before": alarms_before(stats.integrity.limits, first["first_violated_s"]),
        "limits": {each.name: each.as_json() for each in margins},
    }


def summary_of(recorded: Recorded) -> dict[str, Any]:
    """Return the numbers of a recorded run; of one that broke off, those of its cycles."""
    if recorded.summary is not None:
        accepted = acceptance(RunResults.of(recorded.summary), recorded.scenario.requirements)
        of_earlier_versions = dict(zip(("accepted", "required_parts"), accepted, strict=True))
        waived = [waiver.as_json() for waiver in waivers(recorded.rig, recorded.scenario)]
        return {"waived": waived, **of_earlier_versions, **recorded.summary}
    stop = (recorded.end or {}).get("stop", BROKE_OFF)
    run, step_s = recorded.run, recorded.scenario.step_s
    outcome = Outcome(recorded.cycles, stop, faults=[stop])
    return summarise(outcome, recorded.scenario, recorded.rig, run["rig"], int(run["seed"]), 1.0 / step_s)[0]


def docking_go_s(events: Sequence[Event]) -> float | None:
    """Return when docking became a go, None if never."""
    return next((event.t_s for event in events if event.text.startswith(DOCKING_GO)), None)


def safe_stop(outcome: Outcome, scenario: Scenario) -> SafeStop | None:
    """Return the safe stop that ended a run, in the time of the run, None without one."""
    alarm = next((alarm for alarm in outcome.alarms if alarm.text == outcome.stop), None)
    if alarm is None or not len(outcome.history):
        return None
    by = "guard" if ALARMS[alarm.code].by_guard else "device"
    return SafeStop(float(outcome.history["t_s"][-1]) + scenario.step_s, by)


def injected(fault: TimedFault, detected: dict[str, Any]) -> dict[str, Any]:
    """Return a fault that was injected; detected: of ``detection``."""
    return {
        "device": fault.device,
        "kind": fault.kind,
        "at_s": fault.at_s,
        "until_s": fault.until_s,
        "value": list(fault.values),
        **detected,
    }


def gnc_summary(scenario: Scenario) -> dict[str, Any]:
    """Return the GNC library or FMU with the digest of its file, None for the built-in GNC; backends likewise."""
    path = scenario.gnc.binary
    backends = {part: (name, backend_file(name, part)) for part, name in scenario.gnc.foreign.items()}
    return {
        "library": path,
        "sha256": digest_of(path) if path is not None else None,
        **{
            part: {"backend": name, "sha256": digest_of(file) if file is not None else None}
            for part, (name, file) in backends.items()
        },
    }


def sign_off_summary(rig: Rig) -> dict[str, Any] | None:
    """Return who commissioned the rig and whether that was waived; None if no hardware moves."""
    if rig.kind != "hardware":
        return None
    signed, gap = rig.sign_off or SignOff(), sign_off_gap(rig)
    return {
        "valid": not gap,
        "gap": gap,
        "waived": signed.waived,
        "date": signed.date,
        "by": signed.by,
        "key": signed.key,
    }


_AXES: Final = ("x", "y", "z", "roll", "pitch", "yaw")


def control_numbers(history: np.ndarray, scenario: Scenario) -> dict[str, Any] | None:
    """Return what control used at the end of ``history`` (n,) of CYCLE, None if it was not the built-in one.

    The shortest firing is that of the configuration, not that which was measured in flight.
    """
    valid = np.flatnonzero(history["navigation"]["valid"])
    if scenario.gnc.foreign.get("control") or scenario.gnc.binary is not None or not len(valid):
        return None
    params = gnc_params.control(scenario, gnc_params.allocation(scenario.chaser)[1])
    last, rows = history["navigation"][valid[-1]], []
    sigma = [*last["sigma_r_m"], *last["sigma_attitude_rad"]]
    sigma_rate = [*last["sigma_v_mps"], 0.0, 0.0, 0.0]
    for axis, name in enumerate(_AXES):
        pulse = float(params.acceleration[axis] * params.pulse_s)
        lead_s, noise, coast, band = rule_of(params, axis, float(sigma[axis]), float(sigma_rate[axis]), pulse)
        numbers = {"smallest_change": pulse, "noise": noise, "coast": coast, "dead_band": band}
        unit, scale = ("mm", 1e3) if axis < 3 else ("deg", math.degrees(1.0))
        rows.append(
            {"axis": name, "unit": unit, "lead_s": lead_s, "period_s": float(params.period[axis] * params.dt_s)}
            | {key: scale * value for key, value in numbers.items()}
        )
    return {"shortest_firing_s": float(params.pulse_s), "axes": rows}
