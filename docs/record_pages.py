"""Reference pages of the records, made from their field tables."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from docs.c_headers import BACKEND_STRUCTS, STRUCTS
from hil.core import messages
from hil.core.fields import Fields, record_dtype
from hil.parts.fmi.model_stage import RECORDS as MODEL_RECORDS
from hil.parts.monitor.results import PORTION_FIELDS

Section = str | Fields
"""Text, or the fields of a table."""


def markdown_table(fields: Fields) -> str:
    """Return the fields as a table of Markdown: offset in bytes, type, name, unit, frame, meaning."""
    dtype = record_dtype(fields)
    rows = ["| offset | type | field | unit | frame | meaning |", "|---:|---|---|---|---|---|"]
    offsets = [layout[1] for layout in (dtype.fields or {}).values()]
    for field, offset in zip(fields, offsets, strict=True):
        kind = _shown_type(dtype[field.name])
        unit = "" if field.unit == "1" else field.unit
        rows.append(f"| {offset} | {kind} | `{field.name}` | {unit} | {field.frame} | {field.meaning} |")
    return "\n".join([*rows, f"| {dtype.itemsize} | | | | | *size* |"])


def _shown_type(dtype: np.dtype) -> str:
    base = dtype.base
    text = "record" if base.names else (f"S{base.itemsize}" if base.kind == "S" else base.str[1:])
    return text + (f"[{']['.join(map(str, dtype.shape))}]" if dtype.shape else "")


def _page(sections: Sequence[Section]) -> str:
    return "\n\n".join(each if isinstance(each, str) else markdown_table(each) for each in sections) + "\n"


def records() -> str:
    """Return the page of the records of a cycle and of a recording."""
    return _page(
        [
            """# Records

Layout of the records that a recording holds and that the stages of a cycle exchange, from the field tables in
`hil/core/messages.py`, its neighbours `*_records.py` and `hil/parts/monitor/results.py`. Offsets are in bytes from the
start of the record; types are those of numpy, little-endian; nested records have a table of their own.
[Frames](../../explanation/frames.md). Records of an [external GNC](gnc-records.md).

## Cycle

`/cycle`, one per cycle (`CYCLE`); its nested records follow:""",
            messages.CYCLE_FIELDS,
            "## Truth\n\n`truth` (`TRUTH`):",
            messages.TRUTH_FIELDS,
            "## IMU\n\n`imu` (`IMU`):",
            messages.IMU_FIELDS,
            "## Pose\n\n`pose` (`POSE`): chaser relative to target, from a frame of the vision unit:",
            messages.POSE_FIELDS,
            "## Navigation\n\n`navigation` (`NAVIGATION`):",
            messages.NAVIGATION_FIELDS,
            "## Reference\n\n`reference` (`REFERENCE`):",
            messages.REFERENCE_FIELDS,
            "## Approach monitor\n\n`supervision` (`SUPERVISION`):",
            messages.SUPERVISION_FIELDS,
            "## Command\n\n`command` (`COMMAND`):",
            messages.COMMAND_FIELDS,
            "## Axes\n\n`setpoint` and `feedback` (`AXES`):",
            messages.AXES_FIELDS,
            "## Arrival\n\n`/vmu/frames`, one per frame of the vision unit (`ARRIVAL`); `pose` is the pose above:",
            messages.ARRIVAL_FIELDS,
            """## Samples of fast IMU and axes

`/imu`, one per sample of an IMU that is faster than the cycle (`IMU_SAMPLE`); `imu` is the record of the cycle:""",
            messages.IMU_SAMPLE_FIELDS,
            "`/axes`, one per setpoint of axes that are faster than the cycle (`AXES_SAMPLE`):",
            messages.AXES_SAMPLE_FIELDS,
            """## Axes of a rotated target

`/manipulator`, one per cycle of a rig with a [rotary
manipulator](../../explanation/moving-targets.md#rotary-manipulator) (`MANIPULATOR_SAMPLE`); the last two are records
like `setpoint` of the cycle:""",
            messages.MANIPULATOR_SAMPLE_FIELDS,
            "`setpoint` and `feedback` of it:",
            messages.GIMBALS_FIELDS,
            "## Held axes\n\n`/held_axes`, one per cycle and group of held axes or target rails (`HELD_SAMPLE`):",
            messages.HELD_SAMPLE_FIELDS,
            "## Frame of the vision unit\n\n`frame` (`VMU_FRAME`):",
            messages.VMU_FRAME_FIELDS,
            "## Portion\n\n`/monitor/portions`, one per batch of frames of the docking monitor (`PORTION`):",
            PORTION_FIELDS,
        ]
    )


def gnc_records() -> str:
    """Return the page of the records of an external GNC."""
    return _page(
        [
            """# Records of an external GNC

Little-endian, aligned as by a C compiler for x86-64 or ARM64: the structs of `hil_gnc.h`, which `hil gnc header`
prints, byte for byte. Offsets in bytes; f8 is a double, i8 and i4 signed integers of 8 and 4 bytes, u1 a byte, S32
text of 32 bytes padded with zeros.

**Setup**, sent once at the start; it contains the nominal vehicle and plan, without dispersions:""",
            STRUCTS["hil_gnc_setup"],
            """The fields from offset 1440 on are those of protocol 3; over UDP they are the mailbox `gnc.orbit`.
With eccentricity e and mean anomaly M, Kepler's equation E - e sin E = M + n t gives the true anomaly, tan(nu/2) =
sqrt((1 + e)/(1 - e)) tan(E/2), and the rate of Hill's frame, n (1 + e cos nu)^2 / (1 - e^2)^1.5 about -y. The rate
of a target that tumbles follows Euler's equations, J w' = -w x J w, from its rate at t_s = 0; of J only the ratios
count. Values have the errors of the GNC's ephemeris (`gnc.ephemeris`, `gnc.target`).

**Input**, one per cycle:""",
            STRUCTS["hil_gnc_input"],
            "**Pose**, four in each input, of which the first `n_poses` count:",
            STRUCTS["hil_gnc_pose"],
            """**Measured**, from protocol 4 on, as a [backend of navigation](backend-records.md) receives it: each
sample of an IMU that is faster than the cycle, positions whose attitude is a guess, further sensors. Over UDP its
parts are the mailboxes `imu.samples`, `gnc.poses` and `gnc.measurements`, and the input ends before it:""",
            STRUCTS["hil_measured"],
            "Sample of the IMU, pose with its status, and measurement of a further sensor:",
            STRUCTS["hil_backend_sample"],
            STRUCTS["hil_backend_pose"],
            STRUCTS["hil_measurement"],
            "**Output**, one per input:",
            STRUCTS["hil_gnc_output"],
            """`mode`: 0 STANDBY, 1 ARMED (the bench is at rest at the start pose, the time of the run has not
started), 2 RUNNING, 3 HOLD (the axes are braked and time is frozen: keep the state), 4 STOPPED. **Thrusters open
only in RUNNING**: demands in other modes are ignored. `orders`: 1 GO, 2 ABORT, each in one input only. `state`: 0
STARTING (demands are ignored), 1 WORKING, 2 ASKS_FOR_HOLD (an attended bench is braked to rest and continues on
command; an unattended run ends), 3 FAULT (the bench stops; `text` gives the reason). `text` is logged as an event of
the run whenever it changes.""",
        ]
    )


_TITLES = {
    "hil_navigation": "Estimate, `navigation` of the input of control",
    "hil_reference": "Reference, `reference` of the input of control",
    "hil_navigation_input": "Input of navigation",
    "hil_navigation_output": "Output of navigation; preset: no estimate, numbers that are not reported nan",
    "hil_control_input": "Input of control",
    "hil_control_output": "Output of control; preset: no demands",
}


def backend_records() -> str:
    """Return the page of the records of backends."""
    sections: list[Section] = [
        """# Records of backends

The arguments of a backend of navigation or of control ([fly a law](../../how-to/fly-a-law.md), [fly a
filter](../../how-to/fly-a-filter.md)): the structs of `hil_backends.h`, which `hil gnc header --backends` prints,
the records of a kernel, and the objects that a Python class receives. Little-endian, aligned as by a C compiler for
x86-64 or ARM64; offsets in bytes; f8 is a double, i8 and i4 signed integers of 8 and 4 bytes, u1 a byte, S64 text of
64 bytes padded with zeros. `setup`, `samples`, `poses` and `measurements` are those of an [external
GNC](gnc-records.md). In kernels a text is an array of bytes."""
    ]
    for struct, fields in BACKEND_STRUCTS.items():
        sections += [f"**{_TITLES[struct]}** (`{struct}`):", fields]
    return _page(sections)


def model_records() -> str:
    """Return the page of the records of plant models in FMUs."""
    sections: list[Section] = [
        """# Records of plant models

Inputs, outputs and parameters of the FMUs that take the place of [parts of the
plant](../../how-to/from-simulink.md#parts-of-the-plant-as-fmus); parameters that an FMU lacks are not set. Elements are
`on[1]` to `on[24]`."""
    ]
    for name, records in MODEL_RECORDS.items():
        required = ", ".join(f"`{field}`" for field in records.required)
        sections += [
            f"## {name}.fmu\n\nRequired outputs: {required}. **Inputs**:",
            records.inputs,
            "**Outputs**:",
            records.outputs,
            "**Parameters**:",
            records.setup,
        ]
    return _page(sections)
