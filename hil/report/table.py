"""Verdict as text: Table III row by row, the paper's Table V, and explanations of its lines, ``hil run --explain``."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final

from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from hil.checks.waivers import Waiver
from hil.config.camera_identity import NOT_PROVEN
from hil.config.scenario import Requirements
from hil.core.realtime import REAL_TIME
from hil.params.held_back import held_back_text
from hil.params.ready import ROW_NAMES, tolerances
from hil.report import results
from hil.report.results import RunResults, number
from hil.report.verdict import TABLE_V, Verdict

EXPLANATIONS: Final = {
    "control precision": "Deviations of the truth from the ready state, from the ready time to the end, each axis "
    "alone. Margin: 1 - deviation / tolerance of Table III.",
    "security": "Least margins of the truth to the corridor of the approach and to the allowed closing rate.",
    "energy": "Propellant against a multiple of what the plan costs in impulses. No sequence of impulses through the "
    "same states needs less than the impulsive bound.",
    "field of view": "Least distance of an LED from the edge of an image; negative: outside.",
    "integrity": "With each estimate the GNC states a protection level, which bounds its error. Misleading: the error "
    "is beyond an alert limit, the level below it, and no alarm. Available: fraction of the cycles with a level below "
    "its alert limit.",
    "decision": "Docking go by the estimate, checked against the truth. NEES not too large: the mean error squared "
    "over its covariance is no larger than in a filter whose sigmas are right; a budget makes it smaller.",
    "Ready": "First time at which each row of Table III has held for the dwell time.",
    "Navigation": "Root mean square of the error from 100 s on. Bound: Cramér-Rao bound, the least error of any filter "
    "with these sensors over the spread of the error budget: a run with smaller errors may be below it. It is a "
    "reference, not a requirement: an error above it fails no part.",
    "Sensor": "Samples by what the navigation made of them. Mean NIS: 1 per component if noise is as stated.",
    "Thrusters": "Time with a demand on x, y, z, before allocation; firings: openings of all valves.",
    "Bench": "Pose of the camera by the encoders against the truth: the error that rails and turntable add.",
    "Emulated": "The same by the true axes, which no encoder shows.",
    "Latency": "Percentiles: 50 % and 99 % of the values are below p50 and p99.",
    "Timing": "Overruns: cycles that ended after the next one was due. Lateness: start of a cycle after its time.",
    "Host": "Rights of real time that the system has granted to this process.",
    "Clocks": "Synchronisation of the clocks that stamp poses and cycles.",
    "Cameras": "Check of the cameras against their calibration before the run.",
}
"""Begin of a line -> what it means."""


def explanation_of(line: str) -> str:
    """Return the explanation of a line of the verdict, without markup, "" if it has none."""
    text = line.removeprefix("ok  ").removeprefix("fail").strip()
    return next((meaning for name, meaning in EXPLANATIONS.items() if text.startswith(name)), "")


_INDENT: Final = 12
ROW_LABELS = {
    "position_m": ("distance", ("x - {0.axial_distance_m:g} m", "y", "z"), "mm", 1e3),
    "velocity_mps": ("rate", ("x", "y", "z"), "mm/s", 1e3),
    "attitude_deg": ("angle", ("theta1", "theta2", "theta3"), "deg", 1.0),
    "rate_degps": ("angular rate", ("omega1", "omega2", "omega3"), "deg/s", 1.0),
}


def _say(console: Console, text: str | Text, style: str | None = None) -> None:
    """Print ``text`` without line breaks; a Text has no markup."""
    console.print(text, style=style, highlight=False, soft_wrap=True)


def render(
    run: RunResults, verdict: Verdict, requirements: Requirements, console: Console, explain: bool = False
) -> None:
    """Print the run's verdict and key numbers. explain: with what each line means."""
    if verdict.worst is not None:
        console.print(_ready_phase(run, verdict, requirements))
    for line in _lines(run):
        _say(console, line)
        plain = line.plain if isinstance(line, Text) else Text.from_markup(line).plain
        if explain and (meaning := explanation_of(plain)):
            console.print(Padding(Text(meaning, style="dim"), (0, 0, 0, _INDENT)))
    print_sign_off(run.sign_off, console)
    print_waived(run.waived, console)
    word = "[bold green]PASS[/]" if run.accepted else f"[bold red]{'NO VERDICT' if run.withheld else 'FAIL'}[/]"
    beside = run.not_required_text() if run.accepted else f"({_reason(run, verdict)})"
    weak = len(run.waived)
    given_up = f"[bold red]; {weak} protection{'s' * (weak > 1)} waived or weak[/]" if weak else ""
    _say(console, f"{word} {run.scenario} on {run.rig}, seed {run.seed} {beside}".rstrip() + given_up)


def _lines(run: RunResults) -> Iterator[str | Text]:
    """Yield the lines of parts of the verdict and of key numbers."""
    for name, passed, text in verdict_lines(run):
        yield f"{'[green]ok  [/]' if passed else '[red]fail[/]'} {name:<18} {text}"
    yield _ready_text(run)
    if run.gnc and run.gnc["library"] is not None:
        yield Text(f"GNC         {run.gnc['library']}")
    yield _navigation_text(run.navigation)
    if run.orbit["ephemeris"]:
        yield Text(f"Orbit       {run.orbit['ephemeris']}")
    if truth := run.truth:
        yield (
            f"Truth       measured by {truth['measured_by']}, 1 sigma up to {1e3 * truth['sigma_m']:.2f} mm, "
            f"{truth['sigma_deg']:.4f} deg; over {truth['rate_window_s']:g} s {1e3 * truth['sigma_mps']:.2f} mm/s, "
            f"{truth['sigma_degps']:.4f} deg/s"
        )
    for name, sensor in (run.sensors or {}).items():
        yield Text(f"Sensor      {name}: {_sensor_text(sensor)}")
    use, one, two = run.thrusters, number(".1f"), number(".2f")
    yield (
        f"Thrusters   force demand {one(use.force_on_time_s)} s, torque demand {one(use.torque_on_time_s)} s "
        f"({two(use.torque_on_time_360_400_s)} s in 360..400 s), "
        f"{sum(use.thruster_firings)} firings, propellant {use.propellant_kg:.3f} kg"
    )
    yield from _bench_lines(run.bench, run.latency, has_axes=run.truth is None)
    if run.clocks:
        yield f"Clocks      {_clocks_text(run.clocks, run.vision)}"
    if not run.vision.get("identity_proven", 1):
        yield f"Cameras     {NOT_PROVEN}: geometry file or cameras without serial and offset_px"
    if run.drift_check:
        yield f"Cameras     {_drift_text(run.drift_check)}"
    yield from _timing_lines(run.timing)


def _sensor_text(sensor: dict[str, Any]) -> str:
    counts = [f"{sensor[key]} {key.replace('_', ' ')}" for key in ("accepted", "rejected", "excluded", "too_late")]
    nis = "" if sensor["mean_nis"] is None else f", mean NIS per component {sensor['mean_nis']:.2f}"
    suspect = f", suspect {sensor['suspected']} times" if sensor["suspected"] else ""
    reasons = "; ".join(f"{n} refused: {reason}" for reason, n in sensor["refused"].items())
    return "; ".join(filter(None, (f"{', '.join(counts)}{nis}{suspect}", reasons)))


def print_sign_off(sign_off: dict[str, Any] | None, console: Console) -> None:
    """Print who commissioned the hardware; ``print_waived`` reports a missing sign-off."""
    if sign_off is not None and not sign_off["gap"]:
        key = sign_off.get("key")
        text = f"{sign_off['date']} by {sign_off['by']}{f', key {key}' if key else ''}"
        _say(console, Text(f"Sign-off    {text}"))


def print_waived(waived: Sequence[dict[str, str]], console: Console) -> None:
    """Print each waived protection, in red."""
    for waiver in waived:
        _say(console, Text(str(Waiver(**waiver))), style="bold red")


def _timing_lines(timing: results.Timing) -> Iterator[str]:
    late = {name: "-" if us is None else f"{us:.0f}" for name, us in timing.lateness_us.as_json().items()}
    yield (
        f"Timing      {timing.cycles} cycles at {timing.rate_hz:g} Hz, {timing.overruns} overruns, "
        f"{timing.skipped_periods} periods lost, {timing.late_wakeups} late wake-ups, "
        f"lateness p50 {late['p50']} p99 {late['p99']} p99.9 {late['p999']} max {late['max']} us"
    )
    for name, times in vars(timing.devices).items() if timing.devices else ():
        if times is not None and times.beyond:
            yield (
                f"[yellow]            {name}: {times.beyond} times beyond {times.limit_ms:g} ms, "
                f"p50 {times.p50_ms:.2f} p99 {times.p99_ms:.2f} max {times.max_ms:.2f} ms[/]"
            )
    if timing.privileges:
        yield f"Host        {_host_text(timing.privileges)}"
    if timing.overruns:
        yield f"[yellow]            this host is too slow: {timing.overruns} cycles were late; try a lower --speed[/]"


def _host_text(privileges: list[dict[str, Any]]) -> str:
    granted = [p["detail"] for p in privileges if p["granted"]]
    refused = [f"{p['name']} ({p['detail']})" for p in privileges if not p["granted"]]
    kind = "not in real time" if any(p["name"] in REAL_TIME and not p["granted"] for p in privileges) else "real time"
    return "; ".join([f"{kind}: {', '.join(granted) or 'nothing granted'}", *(f"refused {r}" for r in refused)])


def ready_rows(scenario: str, verdict: Verdict, requirements: Requirements) -> Iterator[tuple[str, ...]]:
    """Yield name, axis, unit, limit, largest deviation, margin, Table V, and "ok" or "out", of each of the 12 rows."""
    paper, allowed = TABLE_V.get(scenario), tolerances(requirements)
    assert verdict.worst is not None
    for name in ROW_NAMES:
        label, axes, unit, scale = ROW_LABELS[name]
        for i, axis in enumerate(axes):
            limit, here = allowed[name][i] * scale, verdict.worst[name][i] * scale
            theirs = f"{getattr(paper, name)[i] * scale:.4g}" if paper else "-"
            margin, word = f"{100.0 * (1.0 - here / limit):.0f} %", "ok" if here <= limit else "out"
            yield label, axis.format(requirements), unit, f"{limit:.4g}", f"{here:.3g}", margin, theirs, word


def _ready_phase(run: RunResults, verdict: Verdict, requirements: Requirements) -> Table:
    table = Table(title="Ready phase: largest deviations against Table III", title_justify="left")
    for column in ("", "axis", "limit", "here", "margin", "Table V", ""):
        table.add_column(column, justify="left" if column in ("", "axis") else "right")
    for i, (label, axis, unit, *numbers, word) in enumerate(ready_rows(run.scenario, verdict, requirements)):
        first = "" if i % 3 else f"{label}, {unit}"
        table.add_row(first, axis, *numbers, f"[{'green' if word == 'ok' else 'red'}]{word}[/]", end_section=i % 3 == 2)
    return table


def verdict_lines(run: RunResults) -> list[tuple[str, bool, str]]:
    """Return name, verdict and key numbers of each part of the verdict, as far as ``run`` has it."""
    lines = []
    for name, part in run.parts().items():
        suffix = "" if name in run.required_parts else "; not required"
        lines.append((name.replace("_", " "), bool(part.passed), f"{PART_TEXTS[name](part)}{suffix}"))
    return lines


def _precision_text(part: results.ControlPrecision) -> str:
    if part.margin is None:
        return "never ready"
    text = f"least margin to Table III {100.0 * part.margin:.0f} %"
    duration_s, required_s = part.ready_duration_s or 0.0, part.required_ready_s or 0.0
    return text if duration_s >= required_s else f"{text}, ready for {duration_s:.2f} s, required {required_s:g} s"


def _security_text(part: results.Security) -> str:
    if part.corridor_margin_m is None or part.closing_margin_mps is None:
        return "no cycle was run"
    text = (
        f"corridor margin {part.corridor_margin_m:.3f} m, "
        f"closing-rate margin {1e3 * part.closing_margin_mps:.1f} mm/s, nearest {part.nearest_m:.3f} m"
    )
    abort = part.abort
    if abort is None:
        return text
    drift = abort.drift_from_end
    adrift = "" if drift is None else f", then adrift for an orbit nearest {drift['nearest_m']:.2f} m"
    return (
        f"{text}; aborted at {abort.at_s:.2f} s ({abort.cause}): from {abort.range_m:.2f} m, nearest "
        f"{abort.nearest_m:.2f} m, end {abort.range_at_end_m:.2f} m{adrift}"
    )


def _energy_text(part: results.Energy) -> str:
    allowed, bound = part.factor * part.least_propellant_kg, part.impulsive_bound_kg
    over = f", {part.propellant_kg / bound:.2f} x impulsive bound" if bound else ""
    held = held_back_text(part.held_back_mps2 or 0.0, part.held_back_mps or 0.0)
    return (
        f"propellant {part.propellant_kg:.3f} kg, allowed {allowed:.3f} kg "
        f"({part.factor:g} x impulsive minimum){over}, {part.firings} firings{held and f'; {held}'}"
    )


def _view_text(part: results.FieldOfViewResults) -> str:
    if part.at_s is None:
        return "no LED has to be in view" if part.passed else "no cycle was run"
    margin = "behind a camera" if part.margin_px is None else f"least margin {part.margin_px:.0f} px"
    return f"{margin} at {part.at_s:.2f} s, range {part.range_m:.2f} m"


def _integrity_text(part: results.IntegrityResults) -> str:
    if part.nearest_m is None:
        return "no cycle was run"
    near = f"nearest {part.nearest_m:.3f} m"
    if part.worst_error_m is None:
        return f"no estimate, {near}"
    text = f"error nearest its alert limit {part.worst_error_m:.3f} m of {part.alert_limit_m:.3f} m, {near}"
    if part.hmi_cycles is None:
        return f"{text}; no protection levels"
    available = "" if part.availability is None else f", available {100.0 * part.availability:.1f} %"
    return f"{text}; {part.hmi_cycles} misleading cycles{available}, {part.false_alerts} false alerts"


def _decision_text(part: results.Decision) -> str:
    go = "never a go" if part.go_s is None else f"docking a go at {part.go_s:.2f} s"
    if part.error:
        go += ", with the truth outside the requirement"
    nees = {None: "no NEES", True: "NEES not too large", False: "NEES too large"}[part.nees_ok]
    return f"{go}; {nees}, {part.beyond_level_cycles} cycles beyond the protection level"


PART_TEXTS: Final[Mapping[str, Callable[[Any], str]]] = {
    "control_precision": _precision_text,
    "security": _security_text,
    "energy": _energy_text,
    "field_of_view": _view_text,
    "integrity": _integrity_text,
    "decision": _decision_text,
}
"""Part of the verdict -> function that returns its key numbers as text."""


def _ready_text(run: RunResults) -> str:
    if run.ready_time_s is None:
        return "Ready       never: Table III did not hold for the dwell time"
    paper = TABLE_V.get(run.scenario)
    beside = f" (paper: {paper.ready_time_s:g} s)" if paper and paper.ready_time_s is not None else ""
    return f"Ready       at {run.ready_time_s:.2f} s{beside}, Table III holds since {run.held_since_s:.2f} s"


def _navigation_text(navigation: results.NavigationResults) -> str:
    if navigation.position_rmse_m is None:
        return "Navigation  no estimate: no pose arrived, or the GNC gave none"
    mm, deg = number(".2f", 1e3), number(".4f")
    bound, angle_bound = navigation.position_bound_m, navigation.attitude_bound_deg
    return (
        f"Navigation  position rmse {mm(navigation.position_rmse_m)} mm{f' (bound {mm(bound)})' if bound else ''}, "
        f"attitude rmse {deg(navigation.attitude_rmse_deg)} deg{f' (bound {deg(angle_bound)})' if angle_bound else ''}"
    )


def _bench_lines(bench: results.BenchResults, latency: results.Latency, has_axes: bool) -> Iterator[str]:
    """Yield the bench error, of a bench that has axes, and the latencies of pose and setpoint."""
    if has_axes and (errors := _camera_text(bench.pose_error_mm, bench.pose_error_deg)) is not None:
        fraction = bench.share_of_navigation_error
        share = f", {100.0 * fraction:.1f} % of the navigation error" if fraction is not None else ""
        yield f"Bench       camera error {errors}{share}"
    if bench.unseen_m is not None and bench.unseen_deg is not None:
        yield (
            f"[yellow]            not shown: up to x y z {number('.3f')(bench.unseen_m)} m in H, "
            f"{number('.3f')(bench.unseen_deg)} deg about c, by axes without a drive[/]"
        )
    if has_axes and (text := _energy_added_text(bench.energy or {})):
        yield f"            {text}"
    if (errors := _camera_text(bench.true_pose_error_mm, bench.true_pose_error_deg)) is not None:
        yield f"Emulated    camera error by the true axes, behind the encoders: {errors}"
    times = {
        "pose to command": latency.pose_to_command_ms,
        "to its digital line": latency.pose_to_wire_ms,
        "setpoint to encoder": latency.setpoint_to_encoder_ms,
        "axes behind lead_s": latency.encoder_behind_lead_ms,
        "pose behind IMU": latency.pose_behind_imu_ms,
    }
    shown = [
        f"{name} p50 {each.p50:.2f} p99 {each.p99:.2f} max {each.max:.2f} ms"
        for name, each in times.items()
        if each.p50 is not None
    ]
    if shown:
        yield f"Latency     {', '.join(shown)}"


def _camera_text(mm: results.RmsMax | None, deg: results.RmsMax | None) -> str | None:
    if mm is None or deg is None or mm.rms is None or deg.rms is None:
        return None
    return f"rms {mm.rms:.3f} max {mm.max:.3f} mm, rms {deg.rms:.4f} max {deg.max:.4f} deg"


def _energy_added_text(energy: dict[str, float]) -> str:
    """Return what the axes add to the work of the thrusters, "" for a run in which these do none."""
    parts = [
        f"{100.0 * energy[f'{motion}_added_j'] / energy[f'{motion}_work_j']:+.2f} % in {motion}"
        for motion in ("translation", "rotation")
        if energy.get(f"{motion}_work_j")
    ]
    return f"axes add {', '.join(parts)} to the work of the thrusters" if parts else ""


def _clocks_text(clocks: dict[str, Any], vision: dict[str, int]) -> str:
    """Return PTP at begin and end, steps of the system's time, and the estimate of the vision unit's clock."""
    states = [clocks["ptp"][name] for name in ("begin", "end")]
    text = "no PTP"
    if all(states):
        offsets = " and ".join(f"{state['offset_us']:.3g}" for state in states)
        text = f"PTP {states[-1]['state']}, offset {offsets} us at begin and end"
    text += f"; system time stepped by {clocks['system_step_us']:.0f} us"
    if "clock_ahead_us" not in vision:
        return text
    return (
        f"{text}; vision unit's clock ahead by at least {1e-3 * vision['clock_ahead_us']:.1f} ms, "
        f"drift {1e-3 * vision['clock_drift_ppb']:.1f} ppm, largest step {1e-3 * vision['clock_step_us']:.1f} ms"
    )


def _drift_text(drift: dict[str, Any]) -> str:
    """Return the result of the drift check before the run."""
    moved = f"{' or '.join(drift['moved'])} moved by {drift['shift_px']:.3f} px RMS" if drift["moved"] else "no drift"
    calibration = f"calibration {drift['calibration']} of {drift['date']}"
    return f"{moved} since {calibration}: {drift['views']} views, residuals {drift['rms_px']:.3f} px RMS"


def _reason(run: RunResults, verdict: Verdict) -> str:
    """Return why a run is not accepted: of several reasons the first in time."""
    if run.withheld:
        return run.withheld
    if run.faults:
        return "safe stop"
    if run.verdict.security.abort is not None:
        return "the approach was aborted"
    missed = [name.replace("_", " ") for name in run.missed_parts() if name != "control_precision"]
    reasons = [f"failed: {', '.join(missed)}"] if missed else []
    if "control_precision" in run.missed_parts():
        reasons.insert(0, _not_precise(run.verdict.control_precision.required_ready_s, verdict))
    return "; ".join(reasons) or str(run.stop)


def _not_precise(required_s: float, verdict: Verdict) -> str:
    """Return why control precision was not passed; required_s: least duration of the ready phase, s."""
    if verdict.ready_time_s is None:
        return "the ready phase was not reached"
    if verdict.ready_duration_s < required_s:
        return f"ready for {verdict.ready_duration_s:.2f} s, required {required_s:g} s"
    return "left the ready state"
