"""GNC backends that the compiled loop can run: their state goes to and from LOOP_STATE, their events are logged.

``log_events`` and ``fail`` log the events of one cycle in the order of ``step`` of the backend.
"""

from __future__ import annotations

from typing import NoReturn, Protocol

import numpy as np

from hil.gnc.fusion import new_memory
from hil.gnc_backends.base import GncBackend, Records
from hil.gnc_backends.builtin import BuiltinGnc
from hil.gnc_backends.external import hold_reason
from hil.gnc_backends.shared_library import SharedLibraryGnc, step_failed
from hil.loop.compiled.library_kernel import output_of, set_output


class CompiledBackend(Protocol):
    """Side of a GNC backend that the compiled loop needs."""

    params: np.record
    """GNC_PARAMS."""
    memory: np.ndarray
    """Of the filters, of ``fusion.new_memory``."""

    def load(self, state: np.record) -> None:
        """Write the backend's state to ``state`` (LOOP_STATE)."""

    def store(self, state: np.record) -> None:
        """Read the backend's state from ``state``."""

    def add_innovations(self, cycle: int, nis_position: float, nis_attitude: float) -> None:
        """Check the NIS of ``cycle``, in which poses arrived."""

    def log_events(self, t_s: float, state: np.record) -> None:
        """Log the events of the cycle at ``t_s`` of the run, the last one of ``state``."""

    def request_hold(self) -> None:
        """Request the hold for which the GNC has asked in the last cycle."""

    def fail(self, t_s: float, state: np.record, now: Records) -> NoReturn:
        """Log the events of the cycle at ``t_s`` up to the failure of the GNC; raise it. now: records of the cycle."""


class CompiledBuiltin:
    """The built-in GNC in the compiled loop."""

    def __init__(self, gnc: BuiltinGnc) -> None:
        self.gnc = gnc
        self.params = gnc.params
        self.memory = gnc.memory

    def load(self, state: np.record) -> None:
        state.gnc = self.gnc.state

    def store(self, state: np.record) -> None:
        np.asarray(self.gnc.state)[...] = state.gnc

    def add_innovations(self, cycle: int, nis_position: float, nis_attitude: float) -> None:
        if self.gnc.fuses:
            self.gnc.filter_monitor.add_innovations(cycle, nis_position, nis_attitude)

    def log_events(self, t_s: float, state: np.record) -> None:
        self.gnc.log_step(t_s, state.progress_before.tobytes(), state.now.supervision)

    def request_hold(self) -> None:
        self.gnc.hold_as_asked()

    def fail(self, t_s: float, state: np.record, now: Records) -> NoReturn:
        self.gnc.fail(t_s, state.progress_before.tobytes(), state.now.supervision)


class CompiledLibrary:
    """A GNC in a shared library in the compiled loop."""

    def __init__(self, gnc: SharedLibraryGnc) -> None:
        self.gnc = gnc
        self.params = gnc.params
        self.memory = new_memory(gnc.params.navigation.fusion)

    def load(self, state: np.record) -> None:
        library = state.library
        library.step_address, library.instance = self.gnc.library.step_address, self.gnc.instance_address
        library.input = self.gnc.input
        set_output(library, self.gnc.output)
        library.asks_for_hold = 0
        state.gnc.approach = self.gnc.approach_state

    def store(self, state: np.record) -> None:
        np.asarray(self.gnc.input)[...] = state.library.input
        np.asarray(self.gnc.output)[...] = output_of(state.library)
        np.asarray(self.gnc.approach_state)[...] = state.gnc.approach

    def add_innovations(self, cycle: int, nis_position: float, nis_attitude: float) -> None:
        """The filters of a library are not monitored."""

    def log_events(self, t_s: float, state: np.record) -> None:
        guided = state.library.guided
        self.gnc.event_log.update(t_s, state.progress_before, guided, state.now.supervision)
        self.gnc.log_text(t_s)
        self.gnc.log_progress(t_s, guided.tobytes(), state.now.supervision)

    def request_hold(self) -> None:
        self.gnc.request_hold(hold_reason(self.gnc.name, self.gnc.output))

    def fail(self, t_s: float, state: np.record, now: Records) -> NoReturn:
        self.gnc.event_log.update(t_s, state.progress_before, state.library.guided, state.now.supervision)
        if state.library.code != 0:
            raise step_failed(self.gnc.name, int(state.library.code), self.gnc.output)
        self.gnc.read_output(now, self.gnc.cycle, t_s)
        raise AssertionError("an output with a fault has none")


def compiled_backend(gnc: GncBackend) -> CompiledBackend:
    """Return the side of ``gnc`` for the compiled loop; only the built-in GNC and libraries have one."""
    if isinstance(gnc, SharedLibraryGnc):
        return CompiledLibrary(gnc)
    assert isinstance(gnc, BuiltinGnc)
    return CompiledBuiltin(gnc)
