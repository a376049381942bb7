"""Process of an FMU of its own: opens instances for the bench and answers each input with an output."""

from __future__ import annotations

import json
import select
import socket
import sys
from pathlib import Path
from typing import Any

import numpy as np

from hil.config.scenario import GncConfig
from hil.core.child_process import Parent
from hil.core.gnc_records import GNC_INPUT, GNC_OUTPUT, GNC_SETUP, GncState
from hil.core.messages import new
from hil.errors import BadInput
from hil.gnc_backends.backend import C_STEP, WHOLE, BackendInstance
from hil.gnc_backends.output_texts import whole_text
from hil.parts.fmi.backend import FmuBackend


class _Server:
    """Answers requests of the bench, and inputs that arrive at ``link``."""

    def __init__(self, library: FmuBackend, link: socket.socket) -> None:
        self._library, self._link = library, link
        self._step: Any = None
        self._instance: BackendInstance | None = None
        self._input, self._output = np.zeros(1, GNC_INPUT), np.zeros(1, GNC_OUTPUT)
        self._places = (self._input.ctypes.data, self._output.ctypes.data)

    def answer(self, request: dict[str, Any]) -> dict[str, Any]:
        """Open or close an instance."""
        if self._instance is not None:
            self._instance.close()
            self._instance = None
        if "open" in request:
            setup = new(GNC_SETUP)
            np.asarray(setup)[...] = np.frombuffer(bytes.fromhex(request["open"]), GNC_SETUP)[0]
            self._instance = self._library.open(setup)
            self._step = C_STEP(self._instance.step_address)
        return {}

    def step(self) -> bool:
        """Answer one input; return False once the bench has closed the link."""
        if self._link.recv_into(self._input.data) == 0 or self._instance is None:
            return False
        self._output[...] = np.zeros((), GNC_OUTPUT)
        self._output["cycle"], self._output["state"] = self._input["cycle"], GncState.WORKING
        code = self._step(self._instance.address, *self._places)
        if code == 0:
            self._link.send(self._output.data)
        else:
            self._link.send(np.int32(code).tobytes())
            self._link.send(whole_text(self._output["text"].tobytes(), self._instance.message))
        return True


def _refused(what: str) -> BadInput:
    """Return the error that the bench completes with the name of the file."""
    return BadInput.single("", "gnc.fmu", what)


def main() -> None:
    """Serve until the bench closes stdin."""
    parent = Parent()
    configuration = parent.configuration
    gnc = GncConfig.model_validate_json(json.dumps(configuration["gnc"]))
    link = socket.socket(fileno=int(configuration["descriptor"]))
    try:
        assert gnc.fmu is not None
        library = FmuBackend(gnc.fmu, WHOLE, _refused, gnc, own_process=Path(configuration["folder"]))
    except BadInput as error:
        parent.send(problem=error.problems[0].message)
        return
    server = _Server(library, link)
    parent.send(only_once=library.only_once, receives_measurements=library.receives_measurements)
    while True:
        ready, _, _ = select.select([sys.stdin, link], [], [])
        if sys.stdin in ready:
            try:
                request = parent.receive(None)
            except EOFError:
                return
            try:
                answer = server.answer(request)
            except BadInput as error:
                answer = {"problem": error.problems[0].message}
            parent.send(**answer)
        elif not server.step():
            return


if __name__ == "__main__":
    main()
