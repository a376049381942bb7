"""The seat of a GNC in a shared library: its step is called in the loop's own thread."""

from __future__ import annotations

import numpy as np

from hil.core.gnc_records import GncMode, GncState
from hil.errors import DeviceError
from hil.gnc_backends import library_call
from hil.gnc_backends.external import BackendSetup, ExternalGnc, printable
from hil.gnc_backends.library_file import Instance, Library


class SharedLibraryGnc(ExternalGnc):
    """Flies with ``library``; a session has an instance of it. It is asked in the cycles of a run and of a hold."""

    def __init__(self, library: Library, briefing: BackendSetup) -> None:
        super().__init__(gnc_name(library), briefing)
        self._library = library
        self._instance: Instance | None = None
        self._address = library.step_address
        library_call.compile_step(self.input, self.output)

    def open(self, bench_s: float) -> None:
        """Let the library make an instance. Raises BadInput where it refuses."""
        if self._instance is None:
            self._instance = self._library.open(self.setup)

    def close(self) -> None:
        """Let the library free the instance."""
        if self._instance is not None:
            self._instance.close()
            self._instance = None

    def stand(self, mode: GncMode, bench_s: float) -> None:
        """Tell the library of a cycle of a hold; what it demands there does not count."""
        if mode is not GncMode.HOLD or self._instance is None or self.cycle < 0:
            return
        self.input.mode, self.input.orders, self.input.n_poses = int(mode), 0, 0
        self.exchange()
        if self.output.state == GncState.FAULT:
            self._on_state(self.output)

    def exchange(self) -> bool:
        """Call the library. Raises DeviceError where it says that it failed."""
        assert self._instance is not None
        code = library_call.step(self._address, self._instance.address, self.input, self.output)
        if code != 0:
            raise step_failed(self.name, code, self.output)
        return True


def gnc_name(library: Library) -> str:
    """Return what the GNC of ``library`` is called in what is said of it."""
    return f"gnc {library.name}"


def step_failed(name: str, code: int, output: np.record) -> DeviceError:
    """Return the error of a step that returned ``code``, not 0."""
    said = printable(output.text)
    return DeviceError(name, f"its step returned {code}" + (f": {said}" if said else ""))
