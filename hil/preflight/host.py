"""Host of the loop: facts from the operating system, and checks of them for a run in real time."""

from __future__ import annotations

import os
import platform
import shutil
import time
from dataclasses import dataclass
from pathlib import Path

from hil.core.child_process import ChildProcess
from hil.core.messages import CYCLE
from hil.core.realtime import FIFO_PRIORITY
from hil.errors import DeviceError
from hil.preflight.check import PreflightCheck
from hil.session.compiled import kernels_are_cached

_CLOCK_SOURCE = Path("/sys/devices/system/clocksource/clocksource0/current_clocksource")
_GOVERNORS = Path("/sys/devices/system/cpu")
_REALTIME = Path("/sys/kernel/realtime")
_GOOD_CLOCK_SOURCES = ("tsc", "kvm-clock", "hyperv_clocksource_tsc_page", "arch_sys_counter")
_COARSEST_CLOCK_S = 1e-6
_LEAST_FREE_BYTES = 1e9
_RUNS_TO_STORE = 20


_PROBE_TIMEOUT_S = 20.0


@dataclass(frozen=True, slots=True)
class Privileges:
    """Reasons of refusal as the operating system gives them; "" for a privilege that was granted."""

    fifo_refused: str
    memory_lock_refused: str


def probe_privileges() -> Privileges:
    """Return what a child of this process is refused."""
    try:
        with ChildProcess("privileges probe", "hil.preflight.privileges_probe", {}) as child:
            return Privileges(**child.receive(_PROBE_TIMEOUT_S))
    except DeviceError as error:
        return Privileges(*[f"could not be probed: {error}"] * 2)


@dataclass(frozen=True, slots=True)
class HostFacts:
    """Facts of the host; strings are "" if the system does not report them.

    governors: of each processor that has one. processors: number usable by this process.
    """

    clock_resolution_s: float
    clock_source: str
    privileges: Privileges
    governors: tuple[str, ...]
    processors: int
    free_bytes: float
    kernel: str
    kernel_is_realtime: bool
    kernels_cached: bool


def probe_host(folder: Path) -> HostFacts:
    """Return the facts of this host; ``folder`` is where runs are written."""
    return HostFacts(
        clock_resolution_s=time.get_clock_info("monotonic").resolution,
        clock_source=_text(_CLOCK_SOURCE),
        privileges=probe_privileges(),
        governors=tuple(_text(path) for path in sorted(_GOVERNORS.glob("cpu[0-9]*/cpufreq/scaling_governor"))),
        processors=len(os.sched_getaffinity(0)),
        free_bytes=float(shutil.disk_usage(folder).free),
        kernel=platform.release(),
        kernel_is_realtime=_text(_REALTIME) == "1" or "PREEMPT_RT" in platform.version(),
        kernels_cached=kernels_are_cached("cycle"),
    )


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError):
        return ""


def host_checks(facts: HostFacts, cycles: int, on_hardware: bool) -> list[PreflightCheck]:
    """Return the checks of ``facts`` for runs of ``cycles`` cycles.

    A refused privilege or a power-saving processor fails only for a rig of hardware; else it is informational.
    """
    return [
        _clock(facts),
        _clock_source(facts),
        _scheduling(facts, on_hardware),
        _memory_lock(facts, on_hardware),
        _governor(facts, on_hardware),
        _processors(facts),
        _disk(facts, cycles),
        _kernel(facts),
        _kernel_cache(facts),
    ]


def _clock(facts: HostFacts) -> PreflightCheck:
    fine = facts.clock_resolution_s <= _COARSEST_CLOCK_S
    advice = "" if fine else "use a kernel with high-resolution timers (CONFIG_HIGH_RES_TIMERS)"
    return PreflightCheck(
        "clock resolution", fine, f"{facts.clock_resolution_s * 1e9:g} ns, allowed up to 1 us", advice
    )


def _clock_source(facts: HostFacts) -> PreflightCheck:
    if not facts.clock_source:
        return PreflightCheck("clock source", None, "not exposed")
    fine = facts.clock_source in _GOOD_CLOCK_SOURCES
    advice = "" if fine else "slow to read: boot with clocksource=tsc if the processor's counter is stable"
    return PreflightCheck("clock source", fine, facts.clock_source, advice)


def _scheduling(facts: HostFacts, on_hardware: bool) -> PreflightCheck:
    refused = facts.privileges.fifo_refused
    advice = (
        f"grant CAP_SYS_NICE, or 'rtprio {FIFO_PRIORITY}' in /etc/security/limits.conf (container: --cap-add=SYS_NICE)"
    )
    if not refused:
        return PreflightCheck("scheduling", True, f"SCHED_FIFO, priority {FIFO_PRIORITY}")
    return PreflightCheck("scheduling", _fails(on_hardware), f"SCHED_FIFO, priority {FIFO_PRIORITY}: {refused}", advice)


def _memory_lock(facts: HostFacts, on_hardware: bool) -> PreflightCheck:
    refused = facts.privileges.memory_lock_refused
    advice = "grant CAP_IPC_LOCK, or 'memlock unlimited' in /etc/security/limits.conf (container: --ulimit memlock=-1)"
    if not refused:
        return PreflightCheck("memory lock", True, "all pages")
    return PreflightCheck("memory lock", _fails(on_hardware), refused, advice)


def _governor(facts: HostFacts, on_hardware: bool) -> PreflightCheck:
    if not facts.governors:
        return PreflightCheck("CPU governor", None, "not exposed (virtual machine)")
    slow = sorted(set(facts.governors) - {"performance"})
    if not slow:
        return PreflightCheck("CPU governor", True, "performance")
    return PreflightCheck("CPU governor", _fails(on_hardware), ", ".join(slow), "cpupower frequency-set -g performance")


def _processors(facts: HostFacts) -> PreflightCheck:
    fine = facts.processors >= 2
    advice = "" if fine else "provide a second one: the loop occupies one while it waits for its deadline"
    return PreflightCheck("processors", fine, f"{facts.processors}, required 2 or more", advice)


def _disk(facts: HostFacts, cycles: int) -> PreflightCheck:
    required = max(_LEAST_FREE_BYTES, float(_RUNS_TO_STORE * cycles * CYCLE.itemsize))
    fine = facts.free_bytes >= required
    advice = "" if fine else "free disk space, or run in a folder on another disk"
    value = f"{facts.free_bytes / 1e9:.1f} GB free, required {required / 1e9:.1f} GB ({_RUNS_TO_STORE} runs)"
    return PreflightCheck("disk", fine, value, advice)


def _kernel(facts: HostFacts) -> PreflightCheck:
    if facts.kernel_is_realtime:
        return PreflightCheck("kernel", True, f"{facts.kernel} (PREEMPT_RT)")
    advice = "a PREEMPT_RT kernel bounds the lateness; without one, rely on the measured lateness"
    return PreflightCheck("kernel", None, f"{facts.kernel} (not PREEMPT_RT)", advice)


def _kernel_cache(facts: HostFacts) -> PreflightCheck:
    if facts.kernels_cached:
        return PreflightCheck("compiled kernels", True, "in the cache")
    return PreflightCheck("compiled kernels", None, "not in the cache", "the first run compiles them before any motion")


def _fails(on_hardware: bool) -> bool | None:
    return False if on_hardware else None
