"""Backends of one run or case: their instances, their addresses in the state of the GNC, their texts and failures."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

import numpy as np

from hil.core.messages import Event
from hil.core.observable import ObservableList
from hil.errors import DeviceError
from hil.gnc import backend_step
from hil.gnc_backends.backend import PARTS, BackendInstance, Backends, failure_of
from hil.gnc_backends.external import printable

_MESSAGES_MAX: Final = 200  # logged in a run: a text that changes in each cycle must not fill the log


class OpenBackends:
    """``kinds``, the backends that are not built in, with one instance of each while open.

    setup: GNC_SETUP. The records are BACKENDS of GNC_STATE and GNC_PARAMS.settings.
    """

    def __init__(self, kinds: Backends, setup: np.record) -> None:
        self.kinds = kinds
        self.messages: ObservableList[Event] = ObservableList()
        """Texts of the backends for the operator."""
        self.user_error: BaseException | None = None
        """What a Python object of the user has raised."""
        self.setup = setup
        self._instances: dict[str, BackendInstance] = {}

    def open(self, state: np.record, settings: np.ndarray) -> None:
        """Open an instance of each and write addresses and setup to ``state``. Raises BadInput or DeviceError."""
        if not self.kinds:
            return
        self.close(state)
        setup = np.asarray(self.setup).tobytes()
        for part, kind in self.kinds.items():
            values = settings[PARTS.index(part), : len(kind.settings)]
            try:
                instance = self._instances[part] = kind.open(self.setup, values)
            except DeviceError as error:
                self.user_error = error.__cause__
                raise
            given = state[f"{part}_input"]
            given["setup"] = np.frombuffer(setup, given["setup"].dtype)[0]
            state[part]["step"], state[part]["instance"] = instance.step_address, instance.address

    @contextmanager
    def opened(self, state: np.record, settings: np.ndarray) -> Iterator[None]:
        """Open the instances as long as this lasts."""
        self.open(state, settings)
        try:
            yield
        finally:
            self.close(state)

    def close(self, state: np.record) -> None:
        """Close the instances; the built-in kernels take their place. Idempotent."""
        for part, instance in self._instances.items():
            instance.close()
            state[part]["step"] = 0
        self._instances.clear()

    def set_settings(self, settings: np.ndarray) -> None:
        """Take over other values of the settings between two cycles."""
        for part, instance in self._instances.items():
            instance.set_settings(settings[PARTS.index(part), : len(self.kinds[part].settings)])

    def name(self, part: str) -> str:
        """Return the name of the backend of ``part`` in events and errors."""
        return f"{part} {self.kinds[part].name}"

    def log_texts(self, t_s: float, state: np.record) -> None:
        """Log the text of each backend unless it is the one that was logged last."""
        for part in self.kinds:
            text = printable(bytes(state[part]["text"]))
            last = next((event.text for event in reversed(self.messages) if event.source == self.name(part)), "")
            if text and text != last and len(self.messages) < _MESSAGES_MAX:
                self.messages.append(Event(t_s, self.name(part), text))

    def hold_reason(self, state: np.record) -> str:
        """Return why the bench is to hold if a backend requests it."""
        part = PARTS[int(state["asks_for_hold"]) - 1]
        text = printable(bytes(state[part]["text"]))
        return f"{self.name(part)} asks for it" + (f": {text}" if text else "")

    def failure(self, state: np.record) -> DeviceError:
        """Return the error of the backend that has failed. Raises KeyboardInterrupt if Ctrl-C has ended its step."""
        part = PARTS[int(state["failed"]) - 1]
        instance = self._instances.get(part)
        if instance is not None and state["fault"] == backend_step.RETURNED:
            self.user_error = instance.error
        if isinstance(self.user_error, KeyboardInterrupt):
            raise self.user_error
        return failure_of(self.name(part), state, self.user_error)
