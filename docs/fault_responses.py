"""Responses of the program to each kind of fault, for the page of faults; shown by ``tests/system/test_faults.py``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal


@dataclass(frozen=True)
class FaultResponse:
    """What the program does about a kind of fault, alone and at the sizes of its test.

    detected_by: as in ``injected`` of the JSON, None if not for sure. detection: the monitor, and how soon. test: that
    which shows it.
    """

    detected_by: Literal["navigation", "monitor", "guard", "device"] | None
    detection: str
    reaction: str
    test: str


_TEST: Final = "tests/system/test_faults.py::test_fault_is_detected_as_the_table_states"
_WITHIN: Final = "tests/system/test_faults.py::test_fault_that_is_not_detected_for_sure_stays_within_the_limits"


def _navigation(detection: str, reaction: str) -> FaultResponse:
    return FaultResponse("navigation", f"health: {detection}", reaction, _TEST)


def _excluded(detection: str) -> FaultResponse:
    return FaultResponse("navigation", f"health: {detection}", "the sensor is excluded", _TEST)


def _within(detection: str) -> FaultResponse:
    return FaultResponse(None, detection, "none while truth and estimate are within their limits", _WITHIN)


def _guard(detection: str) -> FaultResponse:
    return FaultResponse("guard", detection, "safe stop", _TEST)


def _both(detection: str) -> FaultResponse:
    return FaultResponse("navigation", f"health; bench guard: {detection}", "hold, later safe stop", _TEST)


def _interlock(detection: str) -> FaultResponse:
    text = f"interlock: two measurements beyond five sigmas of monitor and navigation, {detection}"
    return FaultResponse("monitor", text, "hold, later abort", _TEST)


RESPONSES: Final[dict[str, FaultResponse]] = {
    "vmu.no_pose": _navigation("vision lost; reaction once the protection level asks for it", "hold, later abort"),
    "vmu.sigma_scale": _within("suspect innovations, by their mean NIS, after 10 s to minutes"),
    "vmu.latency": _within("none with the stamp of the exposure; that of the arrival shifts innovations in motion"),
    "vmu.dimmed": _within("vision lost, if too dim at their range; none before, as the report allows for the noise"),
    "imu.bias_step": _within("a jump of the gyros' drift is estimated; IMU or vision suspect, if it cannot be"),
    "imu.scale_factor": _within("suspect innovations once the chaser accelerates or turns"),
    "imu.dropout": _navigation("IMU suspect: readings that repeat", "commanded thrust replaces the IMU, no go"),
    "imu.noise_scale": _within("none: below the noise of the poses"),
    "imu.stuck": _navigation("IMU suspect: ten readings that repeat", "commanded thrust replaces the IMU, no go"),
    "thruster.stuck_open": _navigation("thruster fault, by the IMU", "hold at once, abort once it is named"),
    "thruster.stuck_closed": _navigation("thruster fault, by the IMU, once it was commanded a few times", "abort"),
    "thruster.leak": _navigation(
        "thruster fault, by the IMU, from about a third of the thrust on; below, a disturbance",
        "hold at once, abort once it is named",
    ),
    "thruster.force_scale": _within("thruster fault, by the IMU, from about half of the thrust on"),
    "thruster.delay": _within("none: control allows for it"),
    "thruster.minimum_on": _navigation("thruster fault, by the IMU, from about 0.5 s on", "abort"),
    "vmu.frozen": _both("pose against encoders, once the chaser has moved by five sigmas and for five poses more"),
    "vmu.offset": _both("pose against encoders, five poses if beyond five sigmas"),
    "vmu.drift": _both("pose against encoders, once beyond five sigmas; below that encoders against the estimate"),
    "vmu.outlier": _both("pose against encoders, if five in a row are beyond five sigmas"),
    "vmu.noise_scale": _both("pose against encoders, if five in a row are beyond five reported sigmas"),
    "vmu.misidentified": _both("pose against encoders, five poses"),
    "monitor.frozen": _interlock("once the chaser has moved that far"),
    "monitor.offset": _interlock("if larger"),
    "monitor.drift": _interlock("once larger"),
    "monitor.outlier": _interlock("if two in a row are outliers"),
    "monitor.no_pose": _within("none: the interlock stays as it is while nothing is measured"),
    "monitor.noise_scale": _within("interlock, if two measurements in a row are beyond five reported sigmas"),
    "monitor.sigma_scale": _within("none: a larger one only makes the interlock less strict"),
    "monitor.latency": _within("interlock in motion, if stamped with the arrival"),
    "axis.stuck": _guard("axis against the demand, 0.5 s from 2 mm/s or 0.1 deg/s on"),
    "axis.slow": _guard("axis against the demand, once slower than demanded"),
    "axis.offset": _guard("axis against the demand as the reading steps; later pose against encoders"),
    "axis.oscillation": _guard("axis against the demand, from amplitudes of 0.6 mm or 0.03 deg on"),
    "sensor.no_sample": _within("none: the others carry on, and the protection level grows by what it gave"),
    "sensor.frozen": _excluded("sensor suspect, by its innovations once the chaser has moved"),
    "sensor.offset": _excluded("sensor suspect, by rejections or the CUSUM of its innovations"),
    "sensor.drift": _excluded("sensor suspect, by the CUSUM of its innovations"),
    "sensor.outlier": _within("the gate rejects outliers; sensor suspect if they are many"),
    "sensor.noise_scale": _within("sensor suspect, by its mean NIS, if much larger than reported"),
    "sensor.sigma_scale": _within("sensor suspect, by its mean NIS, if much smaller than the noise"),
    "sensor.latency": _within(
        "none with the stamp of the measurement; that of the arrival shifts innovations in motion"
    ),
    "target.jump": _guard("axis against the demand, if farther than the axes move in three cycles"),
    "target.drift": _both("axis against the demand, if faster than the axes can follow"),
    "target.plume": _within("none: control allows for it as for stronger or weaker thrusters"),
}
"""Device and kind of fault -> response."""
