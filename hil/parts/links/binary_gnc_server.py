"""GNC server of a library or an FMU: a user's GNC in a process, or on a computer, of its own (``hil gnc``).

It is called as in ``hil run``: once per cycle of a run and of a hold. Lost inputs are not made up: the GNC sees their
cycles missing. A new setup opens a new instance.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

import numpy as np

from hil.config.scenario import Scenario
from hil.core.gnc_records import GNC_OUTPUT, TEXT_BYTES, GncMode
from hil.core.messages import new
from hil.errors import BadInput
from hil.frmn.gnc_input import MEASURED
from hil.gnc import whole_step
from hil.gnc_backends.backend import Backend, BackendInstance
from hil.gnc_backends.output_texts import step_failed
from hil.parts.links.gnc_server import WANTS, GncServer
from hil.parts.links.link import Link

OFFERS: Final = ("gnc.output",)
BINARY_WANTS: Final = (*WANTS, *MEASURED)


class BinaryGncServer(GncServer):
    """Serves the bench at the other end of ``link`` with ``library``."""

    def __init__(
        self, library: Backend, scenario: Scenario, link: Link, announce: Callable[[str], None] = lambda _: None
    ) -> None:
        self._library = library
        self._instance: BackendInstance | None = None
        self._result = new(GNC_OUTPUT)
        super().__init__(scenario, link, announce)

    def close(self) -> None:
        """Close the instance."""
        if self._instance is not None:
            self._instance.close()
            self._instance = None

    def _difference(self, setup: np.record) -> str:
        """Open an instance for the bench's setup; return why the binary refuses it, "" if it does not."""
        self.close()
        try:
            self._instance = self._library.open(setup)
        except BadInput as error:
            return error.problems[0].message
        return ""

    def _restart(self) -> None:
        self._last = -1

    def _warm_up(self) -> None:
        whole_step.compile_call(self._input, self._result)

    def _send_idle(self, cycle: int) -> None:
        """Call the GNC in a hold; reply with its state, without demands."""
        if self._input.mode == GncMode.HOLD and cycle > self._last >= 0 and not self._fault:
            self._call()
        super()._send_idle(cycle)

    def _run(self, cycle: int) -> None:
        """Send the output for an input, or repeat the last one."""
        begun_s = time.perf_counter()
        if cycle < self._last:
            return
        if cycle > self._last:
            self._call()
            self._last = cycle
            self.stats.steps += 1
            self.stats.compute_us.append(1e6 * (time.perf_counter() - begun_s))
        if self._fault:
            super()._send_idle(cycle)
        else:
            self.link.send("gnc.output", self._result)

    def _call(self) -> None:
        """Call the step; one that fails is a fault until the next setup."""
        assert self._instance is not None
        code = whole_step.call(self._instance.step_address, self._instance.address, self._input, self._result)
        if code != 0:
            self._fault = step_failed(self._library.name, code, self._result.text).what[:TEXT_BYTES]
            self._announce(self._fault)
