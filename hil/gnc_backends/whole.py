"""Whole GNC behind one call: a shared library, an FMU or a Python object, in the loop's own thread."""

from __future__ import annotations

from typing import Final

import numpy as np

from hil.core.gnc_records import GncMode
from hil.core.kernel_record import kernel_record
from hil.core.messages import CYCLE, IMU, Array, new
from hil.gnc import guidance, whole_step
from hil.gnc.step import GNC_STATE
from hil.gnc_backends.backend import C_STEP, WHOLE, Backend, address_of
from hil.gnc_backends.base import Poses, Records
from hil.gnc_backends.external import NO_POSES, BackendSetup
from hil.gnc_backends.open_backends import CompiledGnc, OpenBackends

_NOTHING: Final = C_STEP(lambda *_: 0)


class WholeGnc(CompiledGnc):
    """Calls an instance of ``backend`` in the cycles of a run and of a hold; a session has one instance."""

    def __init__(self, backend: Backend, setup: BackendSetup, state: np.record | None = None) -> None:
        super().__init__(setup.params, OpenBackends({WHOLE: backend}, setup.setup), setup.event_log, state)
        self.name = self._backends.name(WHOLE)
        self._nees = np.full(2, np.nan)
        self._compile()

    def step(self, t_s: float, now: Records, inbox: Poses) -> None:
        """Run stages 4 to 7 of the cycle; log what has changed."""
        self.cycle += 1
        before = self._progress.tobytes()
        if not whole_step.whole_step(
            self.params, self.state, now.record, now.samples, inbox.poses, inbox.arrived, self.cycle, t_s
        ):
            self.fail(t_s, before, now.supervision)
        self.log_step(t_s, before, now.supervision)
        if self.state["backends"]["asks_for_hold"]:
            self.hold_as_asked()

    def log_step(self, t_s: float, before: bytes, supervision: np.record) -> None:
        """Log the progress since ``before`` (bytes of APPROACH_PROGRESS) in guidance, the text, and what followed."""
        guided = self.state["guided"]
        self.log_progress(t_s, before, supervision, guided)
        self.log_texts(t_s)
        self.log_progress(t_s, guided.tobytes(), supervision)

    def on_idle_cycle(self, mode: GncMode, bench_s: float) -> None:
        """Call the GNC in a cycle of a hold; its demands there have no effect. Raises DeviceError."""
        backends = self.state["backends"]
        if mode is not GncMode.HOLD or not backends["gnc"]["step"] or self.cycle < 0:
            return
        if not whole_step.hold_step(self.state.backends):
            raise self._backends.failure(backends)

    def _compile(self) -> None:
        """Call the kernels once with a GNC that does nothing: nothing compiles once the bench is powered."""
        state, now = kernel_record(new(GNC_STATE)), kernel_record(new(CYCLE))
        guidance.start(self.params.approach.guidance, state.approach.guidance)
        state.backends.gnc.step = address_of(_NOTHING)
        whole_step.whole_step(self.params, state, now, np.zeros(1, IMU), NO_POSES, 0, 0, 0.0)
        whole_step.hold_step(state.backends)

    def consistency(self, truth: np.record, imu: np.record) -> Array:
        """Return nan, (2,): the estimate has no covariance."""
        return self._nees
