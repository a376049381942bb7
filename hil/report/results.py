"""Results of a run: terminal, page, JSON and its reference are made from these tables.

A row is a field here, set where its number is computed; with a label it is among the key numbers as well.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import Field, asdict, dataclass, field, fields
from typing import Any, ClassVar, Self, dataclass_transform

from hil.config.tables.verdict import PART_COLUMNS

Vector = list[float]
Text = Callable[[Any], str]


def row(meaning: str = "", label: str = "", text: Text = str) -> Any:
    """Return a field of results, None unless set. label, text: of a key number, and the function that shows it."""
    return field(default=None, metadata={"meaning": meaning, "label": label, "text": text})


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

    _tables: ClassVar[dict[str, type[Results]]] = {}

    def __init_subclass__(cls) -> None:
        Results._tables[cls.__name__] = dataclass(kw_only=True)(cls)

    @classmethod
    def rows(cls) -> Iterator[tuple[Field[Any], type[Results] | None]]:
        """Yield each row with the table of its content, None for a value."""
        for each in fields(cls):  # type: ignore[arg-type]  # a dataclass
            inner = next(filter(None, map(Results._tables.get, re.findall(r"\w+", str(each.type)))), None)
            yield each, inner

    @classmethod
    def of(cls, content: Mapping[str, Any]) -> Self:
        """Return the results of JSON ``content``; what an earlier version has not written is None."""
        values = {}
        for each, inner in cls.rows():
            value = content.get(each.name)
            values[each.name] = value if inner is None or value is None else inner.of(value)
        return cls(**values)

    def as_json(self) -> dict[str, Any]:
        """Return the results by the keys of the JSON."""
        return asdict(self)  # type: ignore[call-overload, no-any-return]  # a dataclass

    def key_numbers(self) -> Iterator[tuple[str, str]]:
        """Yield label and text of each row with a label, those of inner tables in their places."""
        for each, inner in self.rows():
            value, label = getattr(self, each.name), each.metadata["label"]
            if label:
                yield label, "-" if value is None else each.metadata["text"](value)
            if inner is not None:
                yield from (inner() if value is None else value).key_numbers()


_MM, _PERCENT, _TWO = number(".4g", 1e3), number(".0f", 100.0, " %"), number(".2f")
_RMS, _P50_P99 = parts(".3f", "rms"), parts(".2f", "p50", "p99")


class PartResults(Results):
    """A part of the verdict."""

    passed: bool = row("whether it was passed")


class ControlPrecision(PartResults):
    """Table III over the ready phase."""

    ready_time_s: float | None = row("begin of the ready phase")
    ready_duration_s: float = row("until the end of the run, or its abort")
    required_ready_s: float = row("least duration")
    margin: float | None = row("least of 1 - deviation / tolerance", "least margin to Table III", _PERCENT)


class AbortResults(Results):
    """Course of an abort."""

    cause: str = row("what triggered it")
    at_s: float = row("its time")
    range_m: float = row("distance from the target then")
    nearest_m: float = row("least distance from then on")
    hold_since_s: float | None = row("begin of its hold")
    range_at_end_m: float = row("distance at the end of the run")
    drift_from_trigger: dict[str, Any] | None = row(
        "free drift over one orbit from the trigger on; null without an orbit"
    )
    drift_from_end: dict[str, Any] | None = row("free drift over one orbit from the end of the run on")


class Security(PartResults):
    """Corridor and closing rate on the truth, up to an abort."""

    corridor_margin_m: float | None = row("least margin to the corridor")
    corridor_margin_at_s: float | None = row("its time")
    closing_margin_mps: float | None = row("least margin to the closing rate")
    closing_margin_at_s: float | None = row("its time")
    nearest_m: float | None = row("least distance from the target")
    abort: AbortResults | None = row("course of an abort; null without one")


class Energy(PartResults):
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
    held_back_mps2: float | None = row(
        "largest acceleration that the plane of a planar chaser holds back; null without"
    )
    held_back_mps: float | None = row("its integral, which no thruster has to give")


class FieldOfViewResults(PartResults):
    """LEDs in both images, at the pose that the bench really had."""

    margin_px: float | None = row("least margin to an image's edge; null behind a camera")
    at_s: float | None = row("its time")
    range_m: float | None = row("distance from the target then")
    lost_s: float | None = row("time with an LED outside")


class IntegrityResults(PartResults):
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


class Decision(PartResults):
    """Docking's go."""

    go_s: float | None = row("first [go](../../explanation/integrity.md#go); null for never")
    error: bool = row("a go with the truth outside the requirement")
    nees_ok: bool | None = row(
        "mean NEES of all poses not too large, those before 100 s included; null without a covariance"
    )
    beyond_level_cycles: int = row("cycles with an error beyond the protection level")
    error_over_level: float = row("largest error over protection level")


class VerdictParts(Results):
    """Parts of the verdict that the rows give."""

    control_precision: ControlPrecision = row("Table III")
    security: Security = row("corridor and closing rate")
    energy: Energy = row("propellant")
    field_of_view: FieldOfViewResults = row("LEDs in the images")


class NavigationResults(Results):
    """Errors of the estimate, rms from 100 s on (over all, if shorter); null if the GNC has none."""

    position_rmse_m: Vector | None = row("[3], error of the position", "position rmse x y z, mm", _MM)
    velocity_rmse_mps: Vector | None = row("[3], error of the velocity", "velocity rmse x y z, mm/s", _MM)
    attitude_rmse_deg: Vector | None = row("[3], error of the attitude", "attitude rmse x y z, deg", number(".4g"))
    position_sigma_m: Vector | None = row("[3], the filters' own standard deviation")
    attitude_sigma_deg: Vector | None = row("[3], the filters' own standard deviation")
    position_bound_m: Vector | None = row(
        "[3], Cramér-Rao bound with these poses, this IMU and the error budget, whatever GNC is flown"
    )
    attitude_bound_deg: Vector | None = row("[3], the same of the attitude")
    nees_pkf: float | None = row("mean NEES; 9 if consistent, 7 in the plane", "mean NEES position, settled", _TWO)
    nees_akf: float | None = row("mean NEES; 6 if consistent, 4 in the plane", "mean NEES attitude, settled", _TWO)

    @classmethod
    def of(cls, content: Mapping[str, Any]) -> Self:
        """Return the results of JSON ``content``; versions without the filters' sigmas had another bound."""
        navigation = super().of(content)
        if "position_sigma_m" not in content:
            navigation.position_bound_m = navigation.attitude_bound_deg = None
        return navigation


class ThrusterUse(Results):
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


class BenchResults(Results):
    """Errors of the bench."""

    rail_error_rms_m: Vector | None = row("[3], commanded against measured rails")
    rail_error_max_m: Vector | None = row("[3], the largest")
    gimbal_error_rms_deg: Vector | None = row("[3], commanded against measured gimbals")
    gimbal_error_max_deg: Vector | None = row("[3], the largest")
    pose_error_mm: RmsMax = row("left camera against the truth, by the encoders", "camera error, rms mm", _RMS)
    pose_error_deg: RmsMax = row("the same of its attitude")
    share_of_navigation_error: float | None = row("rms of the pose error over that of the navigation error")
    share_of_attitude_error: float | None = row("the same of the attitude")
    energy: dict[str, float] | None = row("work of the thrusters on the truth, and what the axes add to it")
    limited_cycles: int = row("cycles with a limited setpoint")
    unseen_m: Vector | None = row(
        "[3], largest part of the truth's position that axes without a drive leave out; null if all have one",
        "not shown x y z, mm",
        _MM,
    )
    unseen_deg: Vector | None = row("[3], the same of the attitude, about c")
    true_pose_error_mm: RmsMax | None = row("the same by the true axes", "camera error by true axes, rms mm", _RMS)
    true_pose_error_deg: RmsMax | None = row("the same of its attitude")


class Percentiles(Results):
    """Percentiles of times."""

    p50: float | None = row("median")
    p99: float | None = row("99th percentile")
    max: float | None = row("largest")


class Latency(Results):
    """Latencies."""

    pose_to_command_ms: Percentiles = row("last byte of a pose to its command", "pose to command p50 p99, ms", _P50_P99)
    pose_to_wire_ms: Percentiles = row("to the thruster lines")
    setpoint_to_encoder_ms: Percentiles = row("fitted to 1 s of motion", "setpoint to encoder p50 p99, ms", _P50_P99)
    encoder_behind_lead_ms: Percentiles = row("by how much an axis shows its setpoint later than `lead_s` allows for")
    pose_behind_imu_ms: Percentiles = row("lag of the poses behind their exposures, fitted to 20 s of motion")


class LatenessResults(Percentiles):
    """Lateness of the cycles; null in lock-step."""

    p999: float | None = row("99.9th percentile")


class DeviceTimes(Results):
    """Times of a device against their limit."""

    p50_ms: float | None = row("median")
    p99_ms: float | None = row("99th percentile")
    max_ms: float | None = row("largest")
    limit_ms: float = row("limit")
    beyond: int = row("number beyond it")


class AxisTimes(DeviceTimes):
    """The same of axes."""

    exchange_hz: float | None = row("exchanges per second with the drives; null for devices in memory")


class DeviceResults(Results):
    """Times of the devices."""

    cycle: DeviceTimes = row("from the start of a cycle to its command")
    rails: AxisTimes = row("age of the sample used")
    turntable: AxisTimes = row("age of the sample used")
    vmu: DeviceTimes = row("from the exposure to the last byte")
    io: DeviceTimes = row("from a command to its acknowledgement")


class Timing(Results):
    """Times of loop and devices."""

    rate_hz: float = row("rate of the cycle")
    axes_rate_hz: float = row("rate of the axes")
    imu_rate_hz: float = row("rate of the IMU")
    overruns: int = row("[late cycles](../../explanation/processes.md#real-time)")
    skipped_periods: int = row("lost periods")
    cycles: int = row("executed cycles")
    late_wakeups: int = row("late wake-ups")
    lateness_us: LatenessResults = row(
        "late wake-ups, null in lock-step", "lateness p50 p99 max, us", parts(".0f", "p50", "p99", "max")
    )
    lateness_histogram: list[dict[str, float | int | None]] = row("list of `below_us`, `cycles`")
    devices: DeviceResults = row()
    late_cycle: str = row("overrun policy")
    privileges: list[dict[str, Any]] = row("list of `name`, `granted`, `detail`")


class RunResults(Results):
    """Results of a run."""

    scenario: str = row("what ran")
    build: dict[str, Any] = row("`version`, `commit` of this program")
    seed: int = row("seed")
    rig: str = row("rig")
    accepted: bool = row("[verdict](../../explanation/approach.md#verdict) of the last line and the exit code")
    withheld: str | None = row("why there is no verdict: the bench was not what its encoders showed; null with one")
    required_parts: list[str] = row("parts that the scenario requires")
    passed: bool = row("completed, not aborted, and Table III")
    passed_all_parts: bool = row("the same with all parts, required or not")
    stop: str = row('"completed", or the fault', "stop")
    ready_time_s: float | None = row("first time at which Table III has held for 5 s", "ready, s", _TWO)
    held_since_s: float | None = row("start of those 5 s")
    ready_phase: dict[str, Vector] | None = row("largest absolute deviations of the truth in it")
    verdict: VerdictParts = row("parts of the verdict")
    integrity: IntegrityResults | None = row("part of the verdict")
    decision: Decision | None = row("part of the verdict")
    docking_go_s: float | None = row("first go by the events of the run")
    navigation: NavigationResults = row()
    thrusters: ThrusterUse = row()
    control: dict[str, Any] | None = row("[rule](../../explanation/control.md#the-rule) of the built-in control")
    orbit: dict[str, Any] = row(
        "central `body`; `eclipse_s`, time in its shadow; `ephemeris`, if the GNC's is not good for the whole run"
    )
    gnc: dict[str, Any] = row("library, class or backends, with digests")
    vision: dict[str, int] = row("[counters](wires.md) and [clock](../wire-formats.md#vision-unit) of the vision unit")
    drift_check: dict[str, Any] | None = row("check of the cameras before the run")
    bench: BenchResults = row()
    latency: Latency = row()
    timing: Timing = row("", "overruns, periods lost", lambda of: f"{of.overruns}, {of.skipped_periods}")
    clocks: dict[str, Any] | None = row("PTP and steps of the system's time, on wires")
    truth: dict[str, Any] | None = row("device that measures a truth that is not simulated, its sigmas; else null")
    manipulator: dict[str, Any] | None = row("largest positions, rates and errors of the axes that move the target")
    held_axes: dict[str, Any] | None = row("largest distances of further axes from their places, m or deg, by name")
    sensors: dict[str, dict[str, Any]] | None = row("[further sensors](../../explanation/sensors.md) by name")
    imu: dict[str, int] | None = row("of an IMU on a wire: frames, and those that could not be read, by reason")
    sign_off: dict[str, Any] | None = row("of the commissioning; null unless hardware")
    waived: list[dict[str, str]] = row("[waived protections](../../explanation/safety.md#what-can-be-waived)")
    events: list[dict[str, Any]] = row("list of `t_s`, `source`, `text`")
    injected: list[dict[str, Any]] = row("faults of the scenario, and what detected them")
    faults: list[str] = row("texts of device faults")
    alarms: list[dict[str, Any]] = row("[alarms](alarms.md)")
    first_violated: str = row("[limit](modes.md) that was broken first")
    first_violated_s: float | None = row("its time")
    first_violated_value: float | None = row("its value, SI")
    first_violated_limit: float | None = row("limit")
    first_violated_term: str = row("largest term of a level")
    first_violated_phase: str = row("phase")
    alarms_before: str = row("health bits set up to then")
    limits: dict[str, dict[str, Any]] = row("least margin to each limit")
    monitor: dict[str, Any] | None = row("errors of the docking monitor")
    recording: dict[str, Any] | None = row("of a recorded run: the file and what it lacks")

    def as_json(self) -> dict[str, Any]:
        """Return the results by the keys of the JSON, without ``monitor`` and ``recording`` if there are none."""
        absent = {name for name in ("monitor", "recording") if getattr(self, name) is None}
        return {name: value for name, value in super().as_json().items() if name not in absent}

    def parts(self) -> dict[str, PartResults]:
        """Return the parts of the verdict by name; earlier versions have fewer."""
        of_part = {name: getattr(self, name, None) or getattr(self.verdict, name, None) for name in PART_COLUMNS}
        return {name: part for name, part in of_part.items() if part is not None}

    def missed_parts(self) -> list[str]:
        """Return the required parts that the run did not pass."""
        judged = self.parts()
        return [name for name in self.required_parts if not (name in judged and judged[name].passed)]

    def not_required_text(self) -> str:
        """Return the parts that the scenario does not require, each with its outcome, in brackets; "" without any."""
        outcomes = [
            f"{name.replace('_', ' ')} {'ok' if part.passed else 'fail'}"
            for name, part in self.parts().items()
            if name not in self.required_parts
        ]
        return f"(not required: {', '.join(outcomes)})" if outcomes else ""
