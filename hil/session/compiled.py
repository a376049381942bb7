"""Compiled loop of a session: which jobs it can run, and its assembly from the stages of the cycle in Python."""

from __future__ import annotations

from typing import Literal

from hil.core.jit import processor
from hil.core.kernel_digest import digest_of
from hil.core.kernel_folder import read_kernel_file, remove_unused_kernels, write_kernel_file
from hil.core.part import used_parts
from hil.drivers.io.mock import MockIo
from hil.gnc_backends.open_backends import CompiledGnc
from hil.loop.compiled.cycles import CompiledCycles, MockSources
from hil.loop.compiled.run_cycles import run_cycles
from hil.loop.cycle import Cycles, CyclesOf, Loop
from hil.loop.rate_keeper import SimulatedRate
from hil.session.assembly import Job, Mocks
from hil.session.pose_model import PoseModel

Kernels = Literal["loop", "cycle"]
"""Groups of kernels: those of the compiled loop, and those that the cycle in Python calls one by one."""


def python_only(job: Job) -> str:
    """Return the part of ``job`` that only the cycle in Python has, "" if the compiled loop has all of them.

    An operator needs the cycle in Python as well.
    """
    scenario, rig = job.scenario.value, job.rig.value
    reasons = {
        "the cycle in Python is selected": not job.compiled,
        "devices on wires": rig.kind != "mock",
        "real time": job.paced,
        "a GNC backend of the caller": job.make_backend is not None,
        "command words of a flight computer": rig.flight_computer.command_words != "none",
        "rendered images": job.truth.vmu.source != "model",
        "rendered images of a docking monitor with an interlock": scenario.monitor.interlock
        and job.truth.monitor.source == "rendered",
        "shadow filter": scenario.gnc.shadow.enabled,
        "a floating vehicle": rig.floating is not None,
        "a robot, whose limits are checked in each cycle": bool(rig.robots),
        "parts of the plant in FMUs": bool(job.truth.models),
        "a target or further bodies on axes": rig.target_axes is not None or bool(rig.held_axes),
        "a part that checks each cycle": any(each.part.each_cycle for each in used_parts(scenario, rig)),
        # each cycle could end with an alarm
        "setpoints that expire within two cycles": rig.safety.command_age_max_s < 2.0 * scenario.step_s,
    }
    return next((reason for reason, applies in reasons.items() if applies), "")


def runs_compiled(job: Job) -> bool:
    """Return whether the compiled loop runs ``job`` if no operator gives commands."""
    return not python_only(job)


def kernels_are_cached(group: Kernels) -> bool:
    """Return whether an earlier start left the kernels of ``group``, compiled for these very sources and processor."""
    return read_kernel_file(_mark(group)) == processor().encode()


def mark_kernels_cached(group: Kernels) -> None:
    """Record that every kernel of ``group`` has been compiled once for these sources."""
    write_kernel_file(_mark(group), processor().encode())
    remove_unused_kernels()


def _mark(group: Kernels) -> str:
    return f"{run_cycles.__name__}-{digest_of(run_cycles)}{'' if group == 'loop' else f'-{group}'}"


def compiled_cycles(job: Job, rate: SimulatedRate, mocks: Mocks) -> CyclesOf | None:
    """Return what makes the compiled cycles of a loop of ``job`` on ``mocks``, None if they cannot run it."""
    if not runs_compiled(job):
        return None

    def made(loop: Loop, python: Cycles) -> CompiledCycles:
        gnc, sensor, io = loop.gnc, mocks.sensor, mocks.devices.io
        assert isinstance(gnc, CompiledGnc)
        assert isinstance(sensor, PoseModel)
        assert io is None or isinstance(io, MockIo)
        sources = MockSources(io, sensor.noise, mocks.transport.draws, sensor.leds)
        return CompiledCycles(loop, rate, sources, gnc, python, job.cycles)

    return made
