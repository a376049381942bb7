"""Results of a run: terminal, page, JSON and its reference are made from these tables.

A row is a field here, set where its number is computed; with a label it is among the key numbers as well.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any, Final, Self, dataclass_transform

from hil.config.tables.required_parts import PART_COLUMNS

Vector = list[float]
Text = Callable[[Any], str]


def row(meaning: str, label: str = "", text: Text = str, of: type[Results] | None = None, many: bool = False) -> Any:
    """Return a field of results, None unless set.

    label, text: of a key number, and the function that shows it. of: table of the content, of each entry if ``many``.
    """
    return field(default=None, metadata={"meaning": meaning, "label": label, "text": text, "of": of, "many": many})


def number(form: str, scale: float = 1.0, unit: str = "") -> Text:
    """Return a function that shows a number, or each of a list, in ``form``, scaled."""

    def shown(value: Any) -> str:
        values = value if isinstance(value, list) else [value]
        return " ".join("-" if each is None else f"{scale * each:{form}}{unit}" for each in values)

    return shown


def parts(form: str, *names: str) -> Text:
    """Return a function that shows the rows ``names`` of a table in ``form``."""
    return lambda table: number(form)([getattr(table, name) for name in names])


@dataclass_transform(kw_only_default=True)
class Results:
    """A table of results: its subclasses are dataclasses of rows. Units are the ends of the names."""

    def __init_subclass__(cls) -> None:
        dataclass(kw_only=True)(cls)

    @classmethod
    def of(cls, content: Mapping[str, Any]) -> Self:
        """Return the results of JSON ``content``; what an earlier version has not written is None."""
        values = {}
        for each in fields(cls):  # type: ignore[arg-type]  # of a dataclass
            value, inner = content.get(each.name), each.metadata["of"]
            if inner is not None and value is not None:
                many = each.metadata["many"]
                value = {name: inner.of(entry) for name, entry in value.items()} if many else inner.of(value)
            values[each.name] = value
        return cls(**values)

    def as_json(self) -> dict[str, Any]:
        """Return the results by the keys of the JSON."""
        return asdict(self)  # type: ignore[call-overload, no-any-return]  # a dataclass

    def key_numbers(self) -> Iterator[tuple[str, str]]:
        """Yield label and text of each row with a label, those of inner tables in their places."""
        for each in fields(self):  # type: ignore[arg-type]  # a dataclass
            value, meta = getattr(self, each.name), each.metadata
            if meta["label"]:
                yield meta["label"], "-" if value is None else meta["text"](value)
            elif meta["of"] is not None and not meta["many"]:
                yield from (meta["of"]() if value is None else value).key_numbers()


class Part(Results):
    """A part of the verdict."""

    passed: bool = row("whether it was passed")


class ControlPrecision(Part):
    """Table III over the ready phase."""

    ready_time_s: float | None = row("begin of the ready phase")
    ready_duration_s: float = row("until the end of the run, or its abort")
    required_ready_s: float = row("least duration")
    margin: float | None = row(
        "least of 1 - deviation / tolerance; null if never ready",
        "least margin to Table III",
        number(".0f", 100.0, " %"),
    )


class Abort(Results):
    """Course of an abort."""

    cause: str = row("what triggered it")
    at_s: float = row("its time")
    range_m: float = row("distance from the target then")
    nearest_m: float = row("least distance from then on")
    hold_since_s: float | None = row("begin of its hold")
    range_at_end_m: float = row("distance at the end of the run")
    drift_from_trigger: dict[str, Any] = row("free drift over one orbit from the trigger on")
    drift_from_end: dict[str, Any] = row("free drift over one orbit from the end of the run on")


class Security(Part):
    """Corridor and closing rate on the truth, up to an abort."""

    corridor_margin_m: float | None = row("least margin to the corridor")
    corridor_margin_at_s: float | None = row("its time")
    closing_margin_mps: float | None = row("least margin to the closing rate")
    closing_margin_at_s: float | None = row("its time")
    nearest_m: float | None = row("least distance from the target")
    abort: Abort | None = row("course of an abort; null without one", of=Abort)


class Energy(Part):
    """Propellant against the least that the reference and the slews cost."""

    propellant_kg: float = row("propellant used")
    delta_v_mps: float = row("as if all thrust had acted in one direction")
    least_propellant_kg: float = row("least propellant")
    least_line_mps: float = row("of it the reference as run")
    least_slews_mps: float = row("of it the slews")
    impulsive_bound_mps: float | None = row("least sum of impulses between the states of the reference")
    impulsive_bound_kg: float | None = row("propellant of them and of the slews")
    factor: float = row("allowed multiple of the least propellant")
    firings: int = row("firings of all thrusters")


class FieldOfView(Part):
    """LEDs in both images, at the pose that the bench really had."""

    margin_px: float | None = row("least margin to an image's edge; null behind a camera")
    at_s: float | None = row("its time")
    range_m: float | None = row("distance from the target then")
    lost_s: float | None = row("time with an LED outside")


class Integrity(Part):
    """[Terms](../../explanation/safety.md#integrity)."""

    hmi_cycles: int | None = row("cycles with hazardously misleading information; null without protection levels")
    hmi_by_line1_only: int | None = row("the same without the docking monitor")
    worst_error_m: float | None = row("largest error relative to its alert limit")
    alert_limit_m: float | None = row("alert limit of that cycle")
    protection_level_m: list[float | None] = row("[3], protection level of that cycle")
    availability: float | None = row("fraction of the cycles with a protection level below its alert limit")
    time_to_alert_s: float = row("longest time until an alert")
    nearest_m: float | None = row("least distance from the target")
    false_alerts: int = row("alerts without a cause")
    sensors: str = row('"A": with docking monitor; "B": without')


class Decision(Part):
    """Docking's go."""

    go_s: float | None = row("first [go](../../explanation/integrity.md#go); null for never")
    error: bool = row("a go with the truth outside the requirement")
    nees_ok: bool | None = row("mean NEES consistent; null without a covariance")
    beyond_level_cycles: int = row("cycles with an error beyond the protection level")
    error_over_level: float = row("largest error over protection level")


class VerdictParts(Results):
    """Parts of the verdict that the rows give."""

    control_precision: ControlPrecision = row("Table III", of=ControlPrecision)
    security: Security = row("corridor and closing rate", of=Security)
    energy: Energy = row("propellant", of=Energy)
    field_of_view: FieldOfView = row("LEDs in the images", of=FieldOfView)


_MM: Final = number(".4g", 1e3)


class Navigation(Results):
    """Errors of the estimate, rms from 100 s on (over all, if shorter); null if the GNC has none."""

    position_rmse_m: Vector | None = row("[3], error of the position", "position rmse x y z, mm", _MM)
    velocity_rmse_mps: Vector | None = row("[3], error of the velocity", "velocity rmse x y z, mm/s", _MM)
    attitude_rmse_deg: Vector | None = row("[3], error of the attitude", "attitude rmse x y z, deg", number(".4g"))
    position_sigma_m: Vector | None = row("[3], the filters' own standard deviation")
    attitude_sigma_deg: Vector | None = row("[3], the filters' own standard deviation")
    position_bound_m: Vector | None = row(
        "[3], Cramér-Rao bound with these poses and this IMU, whatever GNC is flown; null without poses or IMU"
    )
    attitude_bound_deg: Vector | None = row("[3], the same of the attitude")
    nees_pkf: float | None = row("mean NEES; 9 for a consistent filter", "mean NEES position, 9 states", number(".2f"))
    nees_akf: float | None = row("mean NEES; 6 for a consistent filter", "mean NEES attitude, 6 states", number(".2f"))

    @classmethod
    def of(cls, content: Mapping[str, Any]) -> Self:
        """Return the results of JSON ``content``; versions without the filters' sigmas had another bound."""
        found = super().of(content)
        if "position_sigma_m" not in content:
            found.position_bound_m = found.attitude_bound_deg = None
        return found


class Thrusters(Results):
    """Use of the thrusters."""

    force_on_time_s: Vector = row("[3], time with a force demand on the axis, before allocation")
    torque_on_time_s: Vector = row("[3], the same of torques")
    torque_on_time_360_400_s: Vector = row("[3], the same from 360 s to 400 s (bench paper Fig. 8)")
    thruster_on_time_s: Vector = row("time open, per thruster")
    propellant_kg: float = row("propellant used", "propellant, kg", number(".4f"))
    thruster_firings: list[int] = row("firings, per thruster", "firings", lambda firings: str(sum(firings)))


class RmsMax(Results):
    """Root mean square and largest magnitude."""

    rms: float | None = row("root mean square")
    max: float | None = row("largest magnitude")


class Bench(Results):
    """Errors of the bench."""

    rail_error_rms_m: Vector | None = row("[3], commanded against measured rails")
    rail_error_max_m: Vector | None = row("[3], the largest")
    gimbal_error_rms_deg: Vector | None = row("[3], commanded against measured gimbals")
    gimbal_error_max_deg: Vector | None = row("[3], the largest")
    pose_error_mm: RmsMax = row(
        "left camera against the truth, by the encoders", "camera error, rms mm", parts(".3f", "rms"), RmsMax
    )
    pose_error_deg: RmsMax = row("the same of its attitude", of=RmsMax)
    share_of_navigation_error: float | None = row("rms of the pose error over that of the navigation error")
    share_of_attitude_error: float | None = row("the same of the attitude")
    energy: dict[str, float] | None = row(
        "[work of the thrusters](../../explanation/control.md#margins-of-the-loop): `translation_added_j`, "
        "`rotation_added_j`: on the truth less that on the bench, above 0 the axes add energy; `translation_work_j`, "
        "`rotation_work_j`: sum of the magnitudes on the truth"
    )
    limited_cycles: int = row("cycles with a limited setpoint")
    true_pose_error_mm: RmsMax | None = row(
        "left camera by the true positions of emulated axes",
        "camera error by true axes, rms mm",
        parts(".3f", "rms"),
        RmsMax,
    )
    true_pose_error_deg: RmsMax | None = row("the same of its attitude", of=RmsMax)


class Percentiles(Results):
    """Percentiles of times."""

    p50: float | None = row("median")
    p99: float | None = row("99th percentile")
    max: float | None = row("largest")


_P50_P99: Final = parts(".2f", "p50", "p99")


class Latency(Results):
    """Latencies."""

    pose_to_command_ms: Percentiles = row(
        "from the last byte of a pose frame to the command that used it",
        "pose to command p50 p99, ms", _P50_P99, Percentiles,
    )  # fmt: skip
    pose_to_wire_ms: Percentiles = row("to the thruster lines", of=Percentiles)
    setpoint_to_encoder_ms: Percentiles = row(
        "from the transmission of a setpoint to the encoder, fitted to each second of motion",
        "setpoint to encoder p50 p99, ms", _P50_P99, Percentiles,
    )  # fmt: skip
    pose_behind_imu_ms: Percentiles = row(
        "by how much poses lag the exposures that they state, against the IMU, fitted to each 20 s of motion; lag of "
        "the axes (`lead_s`) and unstated latency",
        of=Percentiles,
    )


class Lateness(Percentiles):
    """Lateness of the cycles; null in lock-step."""

    p999: float | None = row("99.9th percentile")


class DeviceTimes(Results):
    """Times of a device against their limit."""

    p50_ms: float | None = row("median")
    p99_ms: float | None = row("99th percentile")
    max_ms: float | None = row("largest")
    limit_ms: float = row("limit")
    beyond: int = row("number beyond it")
    exchange_hz: float | None = row("of axes: exchanges per second with the drives; null for devices in memory")


class Timing(Results):
    """Times of loop and devices."""

    rate_hz: float = row("rate of the cycle")
    axes_rate_hz: float = row("rate of the axes")
    imu_rate_hz: float = row("rate of the IMU")
    overruns: int = row("[late cycles](../../explanation/processes.md#real-time)", "overruns")
    skipped_periods: int = row("lost periods", "periods lost")
    cycles: int = row("executed cycles")
    late_wakeups: int = row("late wake-ups")
    lateness_us: Lateness = row("", "lateness p50 p99 max, us", parts(".0f", "p50", "p99", "max"), Lateness)
    lateness_histogram: list[dict[str, float | int | None]] = row("list of `below_us`, `cycles`")
    devices: dict[str, DeviceTimes] = row(
        "`cycle` (wake-up to command), `rails` and `turntable` (age of the sample used), `io` (command to "
        "acknowledgement), `vmu` (exposure to last byte)",
        of=DeviceTimes, many=True,
    )  # fmt: skip
    late_cycle: str = row("overrun policy")
    privileges: list[dict[str, Any]] = row("list of `name`, `granted`, `detail`")


class RunResults(Results):
    """Results of a run."""

    scenario: str = row("what ran")
    build: dict[str, Any] = row("`version`, `commit` of this program")
    seed: int = row("seed")
    rig: str = row("rig")
    accepted: bool = row("[verdict](../../explanation/approach.md#verdict) of the last line and the exit code")
    required_parts: list[str] = row("parts that the scenario requires")
    passed: bool = row("completed, not aborted, and Table III")
    passed_all_parts: bool = row("the same with all parts, required or not")
    stop: str = row('"completed", or the fault', "stop")
    ready_time_s: float | None = row("first time at which Table III has held for 5 s", "ready, s", number(".2f"))
    held_since_s: float | None = row("start of those 5 s")
    ready_phase: dict[str, Vector] | None = row(
        "`position_m`, `velocity_mps`, `attitude_deg`, `rate_degps`: [3], largest absolute deviations of the truth "
        "from `ready_time_s` on; axial distance counts from the ready point"
    )
    verdict: VerdictParts = row("parts of the verdict", of=VerdictParts)
    integrity: Integrity | None = row("part of the verdict", of=Integrity)
    decision: Decision | None = row("part of the verdict", of=Decision)
    docking_go_s: float | None = row("first go by the events of the run")
    navigation: Navigation = row("", of=Navigation)
    thrusters: Thrusters = row("", of=Thrusters)
    control: dict[str, Any] | None = row(
        "[rule](../../explanation/control.md#the-rule) of the built-in control at the end of the run, else null: "
        "`shortest_firing_s`; for each of `axes` the `axis`, its `unit` (mm or deg), `smallest_change` of its rate per "
        "s, `noise` of the switching function, `coast`, `dead_band`, `lead_s`, `period_s`"
    )
    orbit: dict[str, Any] = row("central `body`; `eclipse_s`, time in its shadow")
    gnc: dict[str, Any] = row(
        "`library`, `sha256`, `python`, `navigation.backend`, `.sha256`, `control.backend`, `.sha256`: library or FMU, "
        "class, backends of one's own, with digests"
    )
    vision: dict[str, int] = row("[counters of the vision unit](wires.md) and "
                                 "[its clock](../wire-formats.md#vision-unit)")  # fmt: skip
    drift_check: dict[str, Any] | None = row(
        "if the rig requests it (`[vmu.drift_check]`): `passed`, `calibration`, `date`, `limits`, `views`, `lost` "
        "(views without the target), `points`, `rms_px`, `noise`, `chi_square`, `freedom`, `chance` (probability of "
        "such a deviation by noise alone), `moved`, `shift_px`, and `shift_across_mm`, `shift_depth_mm` of a point at "
        "`range_m`, `explanations` per part"
    )
    bench: Bench = row("", of=Bench)
    latency: Latency = row("", of=Latency)
    timing: Timing = row("", of=Timing)
    clocks: dict[str, Any] | None = row(
        "on wires: `ptp` (`begin` and `end`: `state`, `offset_us`, `path_delay_us`, `grandmaster`; `max_offset_us` of "
        "the rig), `system_step_us`: by how much the system's time moved against bench time"
    )
    manipulator: dict[str, Any] | None = row(
        "`angle_max_deg`, `rate_max_degps`, `following_error_max_deg`: [3], largest of the [rotary "
        "manipulator](../../explanation/moving-targets.md#rotary-manipulator)"
    )
    held_axes: dict[str, Any] | None = row("largest distances of further axes from their places, m or deg, by name")
    sensors: dict[str, dict[str, Any]] | None = row(
        "[further sensors](../../explanation/sensors.md) by name: samples `accepted`, `rejected`, `excluded`, "
        "`too_late`, how often `suspected`, `mean_nis` per component, `refused` by reason"
    )
    sign_off: dict[str, Any] | None = row("null unless hardware; `valid`, `gap`, `waived`, `date`, `by`, `key`")
    waived: list[dict[str, str]] = row(
        "list of `key`, `value`, `takes_away`: [waived protections](../../explanation/safety.md#what-can-be-waived)"
    )
    events: list[dict[str, Any]] = row("list of `t_s`, `source`, `text`")
    injected: list[dict[str, Any]] = row(
        "faults of the scenario: list of `device`, `kind`, `at_s`, `until_s`, `value`, and, null unless detected, "
        '`detected_s`, `detected_by` ("navigation", "monitor", "guard", "device"), `reaction` ("coast", "hold", '
        '"retreat", "abort", "safe stop"), `reaction_s`'
    )
    faults: list[str] = row("texts of device faults")
    alarms: list[dict[str, Any]] = row(
        "list of `t_s`, `device`, `quantity`, `value`, `limit`, `text`, `latched`, `acknowledged`, `priority` "
        '("high": trips; "medium", "low": conditions), `active`, `number`, `acknowledged_by`, `shelved_until_s`, '
        "`code` of the [kind](alarms.md), `measured` and `allowed`: value and limit as numbers in SI `unit`, null if "
        "they are none"
    )
    first_violated: str = row("[limit](modes.md) that was broken first")
    first_violated_s: float | None = row("its time")
    first_violated_value: float | None = row("its value, SI")
    first_violated_limit: float | None = row("limit")
    first_violated_term: str = row("largest term of a level")
    first_violated_phase: str = row("phase")
    alarms_before: str = row("health bits set up to then")
    limits: dict[str, dict[str, Any]] = row(
        "per limit, `lost_periods_of_loop` and `lost_packets_of_DEVICE` among them: least `margin`, `at_s`, `value`, "
        "`limit`, `term`, `unit`, `violated_s` (null: never)"
    )
    monitor: dict[str, Any] | None = row(
        "`source`, `scene`, `frames`, `portions`, `status`, `longest_gap_s`, `frame_ms`, `lag_s`, `missed_rows`, "
        "`failure`, `warning`, and per quantity the errors against `truth`, `bench`, `vmu` (`n`, `mean`, `rms`, "
        "`sigma_rms`, `in_two_sigma`, `most_sigmas`)"
    )
    recording: dict[str, Any] | None = row("of a recorded run: the file and what it lacks")

    def as_json(self) -> dict[str, Any]:
        """Return the results by the keys of the JSON, without ``monitor`` and ``recording`` if there are none."""
        absent = {name for name in ("monitor", "recording") if getattr(self, name) is None}
        return {name: value for name, value in super().as_json().items() if name not in absent}

    def parts(self) -> dict[str, Part]:
        """Return the parts of the verdict by name; earlier versions have fewer."""
        found = {name: getattr(self, name, None) or getattr(self.verdict, name, None) for name in PART_COLUMNS}
        return {name: part for name, part in found.items() if part is not None}

    def missed_parts(self) -> list[str]:
        """Return the required parts that the run did not pass."""
        found = self.parts()
        return [name for name in self.required_parts if not (name in found and found[name].passed)]

    def not_required_text(self) -> str:
        """Return the parts that the scenario does not require, each with its outcome, in brackets; "" without any."""
        outcomes = [
            f"{name.replace('_', ' ')} {'ok' if part.passed else 'fail'}"
            for name, part in self.parts().items()
            if name not in self.required_parts
        ]
        return f"(not required: {', '.join(outcomes)})" if outcomes else ""
