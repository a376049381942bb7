"""Recording of one run, on the side of the loop: catalogue entry, header, recorder and end."""

from __future__ import annotations

import json
import secrets
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np

from hil.core import camera_images
from hil.core.build_info import VERSION
from hil.core.child_process import ChildProcess
from hil.core.clock import utc_ns, utc_text
from hil.core.part import part_sinks, used_parts
from hil.errors import BadInput, DeviceError
from hil.frmn.image_memory import RunTime, image_policy
from hil.frmn.mailbox import MailboxBlock
from hil.frmn.ring import Ring
from hil.params.sensors import sensors_of
from hil.recording import recorder
from hil.recording.audit import DIGEST, ENTRIES, AuditChain
from hil.recording.catalogue import BROKEN_OFF, DONE, Catalogue
from hil.recording.header import header_of
from hil.recording.parts import PartedFile
from hil.recording.sinks import RecordingSinks
from hil.recording.writer import RecordingHeader, RecordingStats
from hil.session.assembly import Job

_RING_S: Final = 5.0  # length of the ring of cycles: longest pause of the recorder without loss
_ROWS_LEAST: Final = 2048
SLOTS: Final = {
    "arrivals": 1024,
    "log": 256,
    "images": camera_images.SLOTS,
}
"""Rows of each ring whose rate is below the cycle's."""
_READY_WALL_S: Final = 60.0
_FINISH_WALL_S: Final = 30.0
_EXIT_WALL_S: Final = 1.0


class _Recorder(Protocol):
    sinks: RecordingSinks
    state: MailboxBlock | None

    def finish(self, end: dict[str, str], summary: str) -> RecordingStats:
        """Close the file."""


class RunRecorder:
    """Recording of a run into ``path``. The run writes to ``sinks``; ``finish`` adds its summary.

    state: ``recorder.STATE_MAILBOX`` if a process of its own writes the file; None otherwise.
    """

    def __init__(self, run: str, path: Path, catalogue: Catalogue, recorder: _Recorder) -> None:
        self.run = run
        self.path = path
        self.sinks = recorder.sinks
        self.state = recorder.state
        self.stats: RecordingStats | None = None
        self._catalogue = catalogue
        self._recorder = recorder

    def finish(self, summary: dict[str, Any]) -> RecordingStats:
        """Close the recording with the run's numbers (as in ``hil run --json``); enter them into the catalogue."""
        return self._finish(DONE, summary["stop"], summary)

    def break_off(self, reason: str) -> RecordingStats:
        """Close the recording of a run without a verdict."""
        return self._finish(BROKEN_OFF, reason, {})

    def _finish(self, state: str, stop: str, summary: dict[str, Any]) -> RecordingStats:
        ended = utc_text()
        audit = self.sinks.audit.summary
        end = {"stop": stop, "ended_utc": ended, ENTRIES: str(audit.entries), DIGEST: audit.digest}
        stats = self._recorder.finish(end, json.dumps(summary, allow_nan=False) if summary else "")
        try:
            self._catalogue.end(self.run, ended, state, stats.cycles, stats.dropped, summary)
            self._catalogue.enter_audit(self.run, *audit)
        except (sqlite3.Error, BadInput) as error:
            problem = stats.problem or f"{self._catalogue.path}: the run's end is not entered: {error}"
            stats = replace(stats, problem=problem)
        self.stats = stats
        return stats


@contextmanager
def recording(job: Job, rig_name: str, folder: Path, announce: Callable[[str], None]) -> Iterator[RunRecorder]:
    """Yield a recording of ``job`` in ``folder``, which is created if necessary.

    A run that ends without ``finish`` is entered as broken off. Raises BadInput if the folder cannot be written.
    """
    started_ns = utc_ns()
    scenario = job.scenario.value
    stamp = utc_text(started_ns)[:19].replace("-", "").replace(":", "")
    run = f"{stamp}Z-{_plain(scenario.name)}-{_plain(Path(rig_name).stem)}-s{job.seed}-{secrets.token_hex(2)}"
    path = folder / f"{run}.mcap"
    catalogue = Catalogue(folder)
    header = header_of(job, rig_name, run, started_ns)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        made: _Recorder = _InMemory(path, header) if job.waits_for_all else _RecorderProcess(job, path, run, header)
    except OSError as error:
        reason = "is no folder" if isinstance(error, FileExistsError) else error.strerror or error
        text = f"{folder}: cannot record there: {reason}"
        raise BadInput.single("--record", "", text) from error
    try:
        catalogue.begin(
            {
                "run": run,
                "started_utc": utc_text(started_ns),
                "scenario": scenario.name,
                "rig": rig_name,
                "seed": job.seed,
                "duration_s": job.duration_s,
                "file": path.name,
                "hil": VERSION,
            }
        )
    except (BadInput, sqlite3.Error) as error:
        made.finish({"stop": "not started", "ended_utc": utc_text()}, "")
        path.unlink(missing_ok=True)
        if isinstance(error, BadInput):
            raise
        text = f"{catalogue.path}: the run cannot be entered: {error}"
        raise BadInput.single("--record", "", text) from error
    made.sinks.audit = AuditChain.begin(header.run, header.files)
    taken = RunRecorder(run, path, catalogue, made)
    announce(f"recording to {path}")
    if isinstance(made, _RecorderProcess):
        announce(f"recorder process {made.pid}")
    try:
        yield taken
    except BaseException as error:
        if taken.stats is None:
            taken.break_off(str(error) or type(error).__name__)
        raise
    if taken.stats is None:
        taken.break_off("no summary")


def _plain(name: str) -> str:
    """Return ``name`` with the characters that are safe in a file name."""
    return "".join(c if c.isalnum() or c in "-_" else "-" for c in name)[:40] or "run"


def required_sinks(job: Job) -> set[str]:
    """Return the names in ``RecordingSinks`` to which a run of ``job`` writes: rings of images are large."""
    scenario, with_images = job.scenario.value, image_policy(job.rig.value).encoding != "none"
    required = {"cycles", "arrivals", "log"}
    if scenario.imu_samples > 1:
        required.add("imu_samples")
    if job.ticks > 1:
        required.add("axes_samples")
    if sensors_of(scenario):
        required.add("sensor_samples")
    if job.rig.value.rotated_target is not None:
        required.add("manipulator_samples")
    if job.rig.value.groups_at_places:
        required.add("held_samples")
    if scenario.vmu.source == "rendered" and with_images:
        required.add("images")
    for used in used_parts(scenario, job.rig.value):
        required |= {name for name, sink in used.part.sinks.items() if sink.topic or with_images}
    return required


def ring_slots(job: Job) -> dict[str, int]:
    """Return the number of rows of each ring of a paced run of ``job``, by its name in ``RecordingSinks``."""
    cycles = max(_ROWS_LEAST, round(_RING_S / job.scenario.value.step_s))
    return {
        "cycles": cycles,
        "manipulator_samples": cycles,
        "held_samples": max(1, len(job.rig.value.groups_at_places)) * cycles,
        "sensor_samples": cycles,
        "imu_samples": max(_ROWS_LEAST, round(_RING_S / job.scenario.value.sample_s)),
        "axes_samples": max(_ROWS_LEAST, round(_RING_S / job.tick_s)),
        **SLOTS,
        **{name: sink.slots for name, sink in part_sinks().items()},
    }


class _FileSink:
    """Sink that writes rows to the file immediately."""

    def __init__(self, write: Callable[[np.ndarray], None]) -> None:
        self._write = write

    def put(self, row: np.ndarray) -> None:
        self._write(row)


class _InMemory:
    """Recorder of a run in simulated time, which waits for it: no row is lost."""

    def __init__(self, path: Path, header: RecordingHeader) -> None:
        self._file = PartedFile(path, header)
        self._run_time = RunTime()
        self.state: MailboxBlock | None = None
        self.sinks = RecordingSinks(
            **{name: _FileSink(write) for name, write in self._file.writers.items()}, run_time=self._run_time
        )

    def finish(self, end: dict[str, str], summary: str) -> RecordingStats:
        self._run_time.close()
        return self._file.finish(end, summary)


class _RecorderProcess:
    """The recorder process and its rings; start it from a thread that lives as long as the run."""

    def __init__(self, job: Job, path: Path, run: str, header: RecordingHeader) -> None:
        self._path = path
        slots = ring_slots(job)
        required = required_sinks(job)
        self._rings = {
            name: Ring.create(dtype, slots[name], name)
            for name, dtype in recorder.ring_dtypes().items()
            if name in required
        }
        self._run_time = RunTime()
        self.sinks = RecordingSinks(**self._rings, run_time=self._run_time)
        self.state: MailboxBlock | None = MailboxBlock.create(recorder.STATE_MAILBOX, "recorder")
        configuration = {
            "file": str(path),
            "run": run,
            "header": {"run": header.run, "files": header.files, "started_ns": header.started_ns},
            "rings": {name: (ring.descriptor, ring.slots) for name, ring in self._rings.items()},
            "state": self.state.descriptor,
        }
        descriptors = (*(ring.descriptor for ring in self._rings.values()), self.state.descriptor)
        self._child = ChildProcess("recorder process", "hil.recording.recorder_process", configuration, descriptors)
        try:
            problem = self._child.wait_ready(_READY_WALL_S)["problem"]
        except DeviceError as error:
            problem = str(error)
        if problem:
            self._close()
            raise OSError(0, problem)

    @property
    def pid(self) -> int:
        return self._child.pid

    def finish(self, end: dict[str, str], summary: str) -> RecordingStats:
        """Let the recorder close the file; return its statistics, or the problem if the recorder has died."""
        self._child.send({"end": end, "summary": summary})
        try:
            return RecordingStats(**self._child.receive(_FINISH_WALL_S))
        except DeviceError:
            size = self._path.stat().st_size if self._path.exists() else 0
            status = f"{self._child.exit_status() or 'does not answer'}{self._child.last_stderr()}"
            text = f"{self._path}: complete the file with hil recover: the recorder process {status}"
            return RecordingStats(None, 0, size, text)
        finally:
            self._close()

    def _close(self) -> None:
        """End the recorder and release the rings."""
        self._child.close(_EXIT_WALL_S)
        for ring in self._rings.values():
            ring.close()
        self._run_time.close()
        if self.state is not None:
            self.state.close()
