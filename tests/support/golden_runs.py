"""Digests of whole runs, campaigns and replays: what must keep its bits while the code around it changes.

    python -m tests.support.golden_runs

writes ``tests/data/golden_runs.json`` again, or the file that is named; the commit that changes a digest names which
formula has changed.
"""

from __future__ import annotations

import hashlib
import json
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import Any, Final
from unittest.mock import patch

import numpy as np

from hil.config.load import load_rig, load_scenario
from hil.core.alarms import Alarm
from hil.core.messages import CYCLE
from hil.parts.campaigns.case_runner import CaseRunner
from hil.parts.campaigns.dispersions import Design, case_seed
from hil.parts.campaigns.outcome import row_of
from hil.recording import session as recording_session
from hil.recording.read import load
from hil.recording.replay import replay
from hil.report.summary import summarise
from hil.session import build
from hil.session.build import Job
from tests.support.run_settings import ALL_ERRORS, make_job

FILE: Final = Path(__file__).parent.parent / "data" / "golden_runs.json"
_SCENARIOS: Final = (
    "departure", "geo", "inspection", "leo-vbar", "limit-cycle", "scheme-1", "scheme-1-printed", "scheme-2",
    "scheme-3", "tumbling-1", "tumbling-3", "tumbling-5",
)  # fmt: skip
_LATE: Final = (
    "vmu.latency_s=0.07", "vmu.latency_jitter_s=0.3", "vmu.duplicate_probability=0.2", "vmu.loss_probability=0.1",
    "rig.vmu.timeout_s=2.0",
)  # fmt: skip
_BUDGET: Final = (
    "gnc.navigation.budget.vision_bias_sigma_m=[0.002, 0.0005, 0.001]",
    "gnc.navigation.budget.vision_misalignment_sigma_deg=0.05",
    "gnc.navigation.budget.vision_correlated_fraction=0.3",
    "gnc.navigation.budget.gyro_scale_sigma=0.01",
)


_EXPLAINED: Final = ("margin_", "first_violated", "alarms_before", "propellant_over_bound")
"""Begins of columns that follow from the rows."""


_ALARM_FIELDS: Final = (
    "t_s", "device", "quantity", "value", "limit", "text", "latched", "acknowledged", "priority", "active", "number",
    "acknowledged_by", "shelved_until_s",
)  # fmt: skip


def _faults(*rows: str) -> str:
    return f"faults=[{', '.join(f'{{{row}}}' for row in rows)}]"


_RUNS: Final = {
    "scheme-1 axes 250 Hz, IMU 200 Hz": ("scheme-1", ("rig.bench.axes_rate_hz=250.0", "imu.rate_hz=200.0")),
    "scheme-2 axes 1 kHz, late poses": ("scheme-2", ("rig.bench.axes_rate_hz=1000.0", *_LATE)),
    "scheme-2 late poses": ("scheme-2", _LATE),
    "scheme-1 all errors": ("scheme-1", (*ALL_ERRORS, *_LATE, "imu.rate_hz=100.0", "rig.guard.enabled=false")),
    "scheme-1 monitor": (
        "scheme-1",
        (
            "monitor.source=model",
            _faults('device = "monitor", kind = "offset", at_s = 5.0, until_s = 9.0, value = [0.1, 0.0, 0.0]'),
        ),
    ),
    "scheme-1 faults": (
        "scheme-1",
        (
            _faults(
                'device = "vmu", kind = "latency", at_s = 3.0, until_s = 5.0, value = 0.1',
                'device = "vmu", kind = "outlier", at_s = 6.0, until_s = 8.0, value = 0.2, size_m = 0.05',
                'device = "imu", kind = "dropout", at_s = 9.0, until_s = 9.5',
                'device = "thruster.3", kind = "stuck_open", at_s = 12.0, until_s = 13.0',
            ),
        ),
    ),
    "scheme-1 stuck rail, axes 250 Hz": (
        "scheme-1",
        (_faults('device = "rails.x", kind = "stuck", at_s = 5.0'), "rig.bench.axes_rate_hz=250.0"),
    ),
    "scheme-1 silent vision unit": ("scheme-1", ("vmu.loss_probability=0.9",)),
    "scheme-1 abort": ("scheme-1", ("gnc.abort.at_s=8.0",)),
}  # fmt: skip
"""Recorded runs of 22 s: scenario and settings by name."""


def _digest(*parts: Any) -> str:
    found = hashlib.sha256()
    for part in parts:
        found.update(part if isinstance(part, bytes) else str(part).encode())
    return found.hexdigest()[:20]


def _case(name: str, settings: tuple[str, ...] = ()) -> str:
    """Return the digest of two dispersed cases of a scenario to its end: each row, and each row of the campaign."""
    scenario, rig = load_scenario(name, settings), load_rig("mock", settings)
    design = Design(scenario, 11)
    runner: CaseRunner | None = None
    parts: list[Any] = []
    for case in (0, 1):
        truth, known = design.apply(design.values(case))
        if runner is None:
            runner = CaseRunner(known, rig.value, known.duration_s)
        else:
            runner.set_gnc_scenario(known)
        history = np.zeros(runner.cycles, CYCLE)
        stats, stop = runner.run(truth, case_seed(11, case), history)
        row = row_of(stats, stop, known, truth)
        row.pop("accepted")  # follows from the others, and from what the scenario requires
        row = {name: value for name, value in row.items() if not name.startswith(_EXPLAINED)}
        parts += [history.tobytes(), json.dumps(row)]
    return _digest(*parts)


def _recorded(job: Job, folder: Path) -> tuple[Any, Path]:
    with (
        patch.object(recording_session, "utc_ns", lambda: 1_700_000_000_000_000_000),
        recording_session.recording(job, "mock", folder, lambda _: None) as taken,
    ):
        with build.runner(job, sinks=taken.sinks) as runner:
            outcome = runner.run()
        scenario, rig = job.scenario.value, job.rig.value
        taken.finish(summarise(outcome, scenario, rig, "mock", job.seed, 1.0 / scenario.step_s)[0])
    return outcome, taken.path


def _run(scenario: str, settings: tuple[str, ...]) -> str:
    """Return the digest of a recorded run: rows, events, alarms, stop, and rows of each recorded stream."""
    job = make_job(22.0, settings, scenario=scenario, seed=3)
    with tempfile.TemporaryDirectory() as folder:
        outcome, path = _recorded(job, Path(folder))
        recorded = load(path)
    batch = recorded.as_batch()
    rows = (outcome.history, batch.arrivals, batch.imu_samples, recorded.axes_samples)
    alarms = f"[{', '.join(map(_alarm_text, outcome.alarms))}]"
    return _digest(outcome.stop, outcome.events, alarms, *(each.tobytes() for each in rows))


def _alarm_text(alarm: Alarm) -> str:
    """Return ``alarm`` as it was digested before it had numbers: its texts, times and states."""
    return f"Alarm({', '.join(f'{name}={getattr(alarm, name)!r}' for name in _ALARM_FIELDS)})"


def _replay(scenario: str, settings: tuple[str, ...]) -> str:
    """Return the digest of the rows of a replay with another dead band."""
    job = make_job(22.0, settings, scenario=scenario, seed=3)
    kept: list[bytes] = []
    with tempfile.TemporaryDirectory() as folder:
        _, path = _recorded(job, Path(folder))
        recorded = load(path)
        changed = load_scenario(scenario, (*settings, "gnc.control.deadband_m=0.02")).value
        replay(recorded, changed, keep=lambda _, now: kept.append(now.tobytes()))
    return _digest(*kept)


def _in_python(scenario: str, settings: tuple[str, ...]) -> str:
    """Return the digest of 8 s by the cycle in Python."""
    job = replace(make_job(8.0, settings, scenario=scenario, seed=3), compiled=False)
    with build.runner(job) as runner:
        outcome = runner.run()
    return _digest(outcome.stop, outcome.events, outcome.history.tobytes())


def cases() -> Iterator[tuple[str, Callable[[], str]]]:
    """Give each case by its name, with the function that returns its digest."""
    for name in _SCENARIOS:
        yield f"campaign {name}", partial(_case, name)
    yield "campaign scheme-1 with an error budget", partial(_case, "scheme-1", _BUDGET)
    for name, (scenario, settings) in _RUNS.items():
        yield f"run {name}", partial(_run, scenario, settings)
    for scenario, settings in (("scheme-1", ()), ("scheme-2", _LATE), ("scheme-3", ()), ("tumbling-3", ())):
        yield f"replay {scenario}", partial(_replay, scenario, settings)
    for scenario in ("scheme-1", "scheme-3", "tumbling-3"):
        yield f"cycle in Python {scenario}", partial(_in_python, scenario, ())


def platform_of_the_bits() -> dict[str, str]:
    """Return what else the bits depend on: the packages that generate code and draw random words."""
    return {name: metadata.version(name) for name in ("numpy", "scipy", "numba", "llvmlite")}


def main() -> None:
    """Write the file, or that of the argument."""
    path = Path(sys.argv[1]) if len(sys.argv) > 1 else FILE
    digests = {name: digest() for name, digest in cases()}
    path.write_text(json.dumps({"platform": platform_of_the_bits(), "digests": digests}, indent=2) + "\n")


if __name__ == "__main__":
    main()
