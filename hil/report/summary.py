"""Key numbers of a run, with the keys of ``hil run --json``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from hil.checks.compatibility import sign_off_gap
from hil.checks.waivers import waivers
from hil.config.faults import TimedFault
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.config.sign_off import SignOff
from hil.core.build_info import build_info
from hil.core.messages import Array, Event
from hil.dynamics.thrusters import STANDARD_GRAVITY_MPS2
from hil.gnc_backends.approach_events import DOCKING_GO
from hil.gnc_backends.backend_registry import backend_file
from hil.gnc_backends.shared_library import digest_of
from hil.loop.overrun_monitor import lateness_histogram, lateness_percentiles_us
from hil.loop.runner import COMPLETED, Outcome
from hil.params.ready import ROW_NAMES, tolerances
from hil.report.acceptance import acceptance, parts_of
from hil.report.bench_energy import judge_energy_added
from hil.report.bench_error import judge_bench_error
from hil.report.control_numbers import control_numbers
from hil.report.device_times import count_beyond, execution_times_s, judge_times, with_exchanges
from hil.report.integrity import IntegrityJudge, SafeStop, decision_part, detection, integrity_part, mean_nees
from hil.report.latency import measure_latency
from hil.report.limits import RunNumbers, alarms_before, first_violated, margins_of, stop_of_alarm
from hil.report.navigation_bound import NavigationBound
from hil.report.verdict import Verdict, judge_rows
from hil.report.verdict_parts import frame_delta_v, judge_energy, judge_field_of_view, judge_security
from hil.safety.guard_alarms import GUARD_QUANTITIES

if TYPE_CHECKING:
    from hil.recording.read import Recorded

BROKE_OFF: Final = "the recording broke off"
SETTLED_S = 100.0  # navigation errors count from here on, as in the paper's numerical simulation
_TORQUE_WINDOW_S = (360.0, 400.0)  # bench paper Fig. 8


RMS_KEYS: Final = (
    "position_rmse_m", "velocity_rmse_mps", "attitude_rmse_deg", "position_sigma_m", "attitude_sigma_deg",
)  # fmt: skip
"""Errors of navigation that are root mean squares, three values each."""


def summarise(
    outcome: Outcome,
    scenario: Scenario,
    rig: Rig,
    rig_name: str,
    seed: int,
    rate_hz: float,
    numbers: tuple[dict[str, Any], Verdict] | None = None,
) -> tuple[dict[str, Any], Verdict]:
    """Return the run's numbers as JSON content, and the verdict; None for quantities that the run did not reach.

    numbers: of ``numbers_of``, if ``outcome.history`` has the last rows of a long run only.
    """
    history = outcome.history
    found, verdict = numbers or numbers_of(history, scenario, rig)
    parts, timing, judged = found["verdict"], found["timing"], found["integrity"]
    aborted = bool(len(history) and history["supervision"]["aborted"][-1])
    passed = verdict.passed and outcome.stop == COMPLETED and not aborted
    summary = {
        "scenario": scenario.name,
        "build": build_info()._asdict(),
        "seed": seed,
        "rig": rig_name,
        "passed": passed,
        "stop": outcome.stop,
        "ready_time_s": verdict.ready_time_s,
        "held_since_s": verdict.held_since_s,
        "ready_phase": {name: _list(verdict.worst[name]) for name in ROW_NAMES} if verdict.worst else None,
        "verdict": parts,
        "integrity": judged["part"],
        "decision": judged["decision"],
        "docking_go_s": docking_go_s(outcome.events),
        "navigation": found["navigation"],
        "thrusters": found["thrusters"],
        "control": control_numbers(history, scenario),
        "orbit": {"body": scenario.orbit.body} | found["orbit"],
        "gnc": gnc_summary(scenario),
        "vision": outcome.vision_counters,
        "drift_check": outcome.measured.get("drift_check") or None,
        "bench": found["bench"]
        | {"limited_cycles": outcome.limited_cycles}
        | outcome.measured.get("bench", dict.fromkeys(("true_pose_error_mm", "true_pose_error_deg"))),
        "latency": found["latency"],
        "timing": {
            "rate_hz": rate_hz,
            "axes_rate_hz": rate_hz * rig.ticks(scenario.step_s),
            "imu_rate_hz": rate_hz * scenario.imu_samples,
            "overruns": outcome.overruns,
            "skipped_periods": outcome.skipped_periods,
            **timing,
            "devices": with_exchanges(timing["devices"], outcome.measured.get("exchanges", {})),
            "late_cycle": rig.on_overrun,
            "privileges": [{"name": g.name, "granted": g.granted, "detail": g.detail} for g in outcome.privileges],
        },
        "clocks": outcome.measured.get("clocks"),
        "manipulator": outcome.measured.get("manipulator"),
        "sensors": outcome.measured.get("sensors"),
        "sign_off": sign_off_summary(rig),
        "waived": [waiver.as_json() for waiver in waivers(rig, scenario)],
        "events": [{"t_s": event.t_s, "source": event.source, "text": event.text} for event in outcome.events],
        "injected": [
            injected(fault, detection(judged["state"], k, fault, safe_stop(outcome, scenario)))
            for k, fault in enumerate(scenario.faults)
        ],
        "faults": outcome.faults,
        "alarms": [alarm.as_json() for alarm in outcome.alarms],
    }
    summary["passed_all_parts"] = passed and all(part["passed"] for part in parts_of(summary).values())
    accepted = acceptance(summary, scenario.requirements)
    limits = limits_of(outcome, judged["state"], verdict, summary | accepted, scenario)
    return accepted | summary | limits, verdict


def limits_of(
    outcome: Outcome, state: np.record, verdict: Verdict, summary: dict[str, Any], scenario: Scenario
) -> dict[str, Any]:
    """Return the first violated limit, the alarms before it and the margins. state: INTEGRITY_STATE."""
    ready, parts, view = verdict.ready, parts_of(summary), summary["verdict"]["field_of_view"]
    energy, n = summary["verdict"]["energy"], len(outcome.history)
    end_s, stop = float(outcome.history["t_s"][-1]) if n else 0.0, None
    if outcome.stop != COMPLETED:
        alarm = next((alarm for alarm in outcome.alarms if alarm.text == outcome.stop), None)
        stop = stop_of_alarm(alarm, outcome.stop, end_s)
    assert ready is not None
    run = RunNumbers(
        state,
        ready,
        {name: bool(part["passed"]) for name, part in parts.items()},
        (view["margin_px"], view["at_s"], view["at_s"]),
        (energy["propellant_kg"], energy["factor"] * energy["least_propellant_kg"]),
        mean_nees(state),
        end_s,
        bool(summary["accepted"]),
        stop,
    )
    margins = margins_of(run, scenario)
    found = first_violated(run, scenario, margins)
    return found | {
        "alarms_before": alarms_before(state.limits, found["first_violated_s"]),
        "limits": {each.name: each.as_json() for each in margins},
    }


def numbers_of(history: np.ndarray, scenario: Scenario, rig: Rig) -> tuple[dict[str, Any], Verdict]:
    """Return what the rows of a run, (n,) of CYCLE, give: tables of its JSON, and the verdict."""
    verdict = judge_rows(history, scenario.requirements)
    thrusters = thrusters_of(history, scenario)
    bound = NavigationBound(scenario, rig, SETTLED_S)
    bound.add(history)
    firings = sum(thrusters["thruster_firings"])
    return {
        "verdict": {
            "control_precision": control_precision(verdict, scenario),
            "security": judge_security(history, scenario),
            "energy": judge_energy(
                history["reference"]["v_CT_H"],
                scenario,
                thrusters["propellant_kg"],
                firings,
                frame_delta_v(history, scenario),
            ),
            "field_of_view": judge_field_of_view(history, rig, scenario.step_s, scenario.bench),
        },
        "integrity": integrity_of(judge_integrity(history, scenario, rig), scenario),
        "navigation": navigation_errors(history) | bound.as_json(),
        "thrusters": thrusters,
        "orbit": {"eclipse_s": eclipse_s(history, scenario.step_s)},
        "bench": axis_errors(history)
        | judge_bench_error(history, rig, scenario.step_s, SETTLED_S, scenario.bench)
        | {"energy": judge_energy_added(history, scenario, rig)},
        "latency": measure_latency(history, scenario.step_s, scenario.step_s / rig.ticks(scenario.step_s)),
        "timing": lateness_counts(history["lateness_s"], rig)
        | {
            "lateness_us": lateness_percentiles_us(history["lateness_s"]),
            "devices": devices_of(history, rig, scenario),
        },
    }, verdict


def devices_of(history: np.ndarray, rig: Rig, scenario: Scenario) -> dict[str, Any]:
    """Return execution times of the cycle and the devices, with their limits."""
    times_s = execution_times_s(history)
    return judge_times(times_s, count_beyond(times_s, rig, scenario.step_s), rig, scenario.step_s)


def summary_of(recorded: Recorded) -> dict[str, Any]:
    """Return the numbers of a recorded run; of one that broke off, those of its cycles."""
    if recorded.summary is not None:
        of_earlier_versions = acceptance(recorded.summary, recorded.scenario.requirements)
        waived = [waiver.as_json() for waiver in waivers(recorded.rig, recorded.scenario)]
        return {"waived": waived, **of_earlier_versions, **recorded.summary}
    stop = (recorded.end or {}).get("stop", BROKE_OFF)
    run, step_s = recorded.run, recorded.scenario.step_s
    outcome = Outcome(recorded.cycles, stop, faults=[stop])
    return summarise(outcome, recorded.scenario, recorded.rig, run["rig"], int(run["seed"]), 1.0 / step_s)[0]


def judge_integrity(history: np.ndarray, scenario: Scenario, rig: Rig) -> np.record:
    """Return INTEGRITY_STATE of the rows (n,) of CYCLE of a run."""
    judge = IntegrityJudge(scenario, rig)
    judge.add(history)
    return judge.state


def integrity_of(state: np.record, scenario: Scenario) -> dict[str, Any]:
    """Return the parts of the verdict about integrity and decision, with the state that they are made of."""
    return {"part": integrity_part(state, scenario), "decision": decision_part(state), "state": state}


def docking_go_s(events: Sequence[Event]) -> float | None:
    """Return when docking became a go, None if never."""
    return next((event.t_s for event in events if event.text.startswith(DOCKING_GO)), None)


def safe_stop(outcome: Outcome, scenario: Scenario) -> SafeStop | None:
    """Return the safe stop that ended a run, in the time of the run, None without one."""
    alarm = next((alarm for alarm in outcome.alarms if alarm.text == outcome.stop), None)
    if alarm is None or not len(outcome.history):
        return None
    by = "guard" if alarm.quantity.startswith(GUARD_QUANTITIES) else "device"
    return SafeStop(float(outcome.history["t_s"][-1]) + scenario.step_s, by)


def injected(fault: TimedFault, found: dict[str, Any]) -> dict[str, Any]:
    """Return a fault that was injected; found: of ``detection``."""
    return {
        "device": fault.device,
        "kind": fault.kind,
        "at_s": fault.at_s,
        "until_s": fault.until_s,
        "value": list(fault.values),
        **found,
    }


def eclipse_s(history: np.ndarray, step_s: float) -> float:
    """Return the time in the shadow of the central body, s; penumbra counts by the covered fraction of the Sun."""
    return step_s * float(np.sum(1.0 - history["truth"]["sunlight"]))


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
    found, gap = rig.sign_off or SignOff(), sign_off_gap(rig)
    return {"valid": not gap, "gap": gap, "waived": found.waived, "date": found.date, "by": found.by, "key": found.key}


def lateness_counts(lateness_s: Array, rig: Rig) -> dict[str, Any]:
    """Return cycles, late wake-ups and the histogram of the lateness."""
    return {
        "cycles": len(lateness_s),
        "late_wakeups": int(np.count_nonzero(lateness_s * 1e6 > rig.host.late_wakeup_us)),
        "lateness_histogram": lateness_histogram(lateness_s),
    }


def control_precision(verdict: Verdict, scenario: Scenario) -> dict[str, Any]:
    """Return Table III over the ready phase; margin: the least of 1 - deviation / tolerance, None if never ready."""
    allowed = tolerances(scenario.requirements)
    worst = verdict.worst
    margin = None if worst is None else min(float((1.0 - worst[n] / allowed[n]).min()) for n in ROW_NAMES)
    return {
        "passed": verdict.passed,
        "ready_time_s": verdict.ready_time_s,
        "ready_duration_s": verdict.ready_duration_s,
        "required_ready_s": scenario.requirements.required_ready_s,
        "margin": margin,
    }


def _list(values: Array) -> list[float]:
    return [float(value) for value in values]


def navigation_errors(history: np.ndarray) -> dict[str, Any]:
    """Return the errors of the estimate, and the filters' own sigmas, from SETTLED_S on (over all, if shorter)."""
    truth, estimate = history["truth"], history["navigation"]
    known = estimate["valid"] == 1
    late = known & (history["t_s"] >= SETTLED_S)
    chosen = np.flatnonzero(late if late.any() else known)  # of fields: to copy whole rows takes longer than all else
    if not len(chosen):
        return dict.fromkeys((*RMS_KEYS, "nees_pkf", "nees_akf"))
    return {
        "position_rmse_m": _rms((truth["r_CT_H"] - estimate["r_CT_H"])[chosen]),
        "velocity_rmse_mps": _rms((truth["v_CT_H"] - estimate["v_CT_H"])[chosen]),
        "attitude_rmse_deg": _rms(np.degrees(attitude_error(history)[chosen])),
        "position_sigma_m": _rms(estimate["sigma_r_m"][chosen]),
        "attitude_sigma_deg": _rms(np.degrees(estimate["sigma_attitude_rad"][chosen])),
        "nees_pkf": _mean(history["nees_position"][chosen]),
        "nees_akf": _mean(history["nees_attitude"][chosen]),
    }


def attitude_error(history: np.ndarray) -> Array:
    """Return the small-angle rotation from the estimated to the true attitude in each row, (n, 3), rad, in c."""
    q, p = history["truth"]["q_CH"], history["navigation"]["q_CH"]
    # twice the vector part of q_true * conj(q_estimate)
    vector = p[:, 3:] * q[:, :3] - q[:, 3:] * p[:, :3] + np.cross(q[:, :3], p[:, :3])
    rotation: Array = 2.0 * vector * np.sign(np.sum(p * q, axis=1))[:, None]
    return rotation


def _rms(values: Array) -> list[float] | None:
    rms = np.sqrt(np.mean(values**2, axis=0))
    return _list(rms) if np.isfinite(rms).all() else None


def _mean(values: Array) -> float | None:
    """Return the mean of the finite values, None without any."""
    known = values[np.isfinite(values)]
    return float(np.mean(known)) if len(known) else None


def thrusters_of(history: np.ndarray, scenario: Scenario) -> dict[str, Any]:
    """Return the use of the thrusters: demands, open times, firings, propellant."""
    command, truth = history["command"], history["truth"]
    n = len(scenario.chaser.thrusters.position_m)
    step = scenario.step_s
    fraction = truth["thrust_fraction"][:, :n]
    open_now = fraction > 0.0
    opened = open_now & ~np.vstack([np.zeros((1, n), dtype=bool), open_now[:-1]]) if len(history) else open_now
    window = (history["t_s"] >= _TORQUE_WINDOW_S[0]) & (history["t_s"] < _TORQUE_WINDOW_S[1])
    return {
        "force_on_time_s": _list(step * (command["force"] != 0).sum(axis=0)),
        "torque_on_time_s": _list(step * (command["torque"] != 0).sum(axis=0)),
        "torque_on_time_360_400_s": _list(step * (command["torque"][window] != 0).sum(axis=0)),
        "thruster_on_time_s": _list(step * fraction.sum(axis=0)),
        "thruster_firings": [int(count) for count in opened.sum(axis=0)],
        "propellant_kg": _propellant(truth, step * float(fraction.sum()), scenario),
    }


def _propellant(truth: np.ndarray, open_s: float, scenario: Scenario) -> float:
    """Return the propellant used, kg; if the truth loses no mass, that of valves open for ``open_s``."""
    if len(truth) and scenario.truth.mass_loss:
        return float(truth["mass_kg"][0] - truth["mass_kg"][-1])
    thrusters = scenario.chaser.thrusters
    return open_s * thrusters.force_n / (thrusters.specific_impulse_s * STANDARD_GRAVITY_MPS2)


def axis_errors(history: np.ndarray) -> dict[str, Any]:
    """Return commanded against measured axes, rms and largest; a row's setpoint is that for its own time."""
    rows = history[1:]
    if not len(rows):
        return {}
    rail = rows["setpoint"]["rail_m"] - rows["feedback"]["rail_m"]
    gimbal = np.degrees(rows["setpoint"]["gimbal_rad"] - rows["feedback"]["gimbal_rad"])
    return {
        "rail_error_rms_m": _rms(rail),
        "rail_error_max_m": _list(np.abs(rail).max(axis=0)),
        "gimbal_error_rms_deg": _rms(gimbal),
        "gimbal_error_max_deg": _list(np.abs(gimbal).max(axis=0)),
    }
