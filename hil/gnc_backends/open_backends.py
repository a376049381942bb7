"""Backends in flight: one open instance of each, and the base class of GNCs whose step is one compiled call."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final, NoReturn

import numpy as np

from hil.core.kernel_record import kernel_record
from hil.core.messages import Event, new
from hil.core.observable import ObservableList
from hil.errors import DeviceError, ProtocolError
from hil.gnc import backend_outputs
from hil.gnc.estimation.step_memory import new_memory
from hil.gnc.step import GNC_STATE
from hil.gnc_backends.approach_events import ApproachEventLog
from hil.gnc_backends.backend import ANY_PART, NO_SETTINGS, PARTS, WHOLE, BackendInstance, Backends, failure_of
from hil.gnc_backends.base import GncBackend
from hil.gnc_backends.output_texts import hold_reason, printable

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
            try:
                instance = self._instances[part] = kind.open(self.setup, self._values(part, settings))
            except DeviceError as error:
                self.user_error = error.__cause__
                raise
            if part != WHOLE:
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
            instance.set_settings(self._values(part, settings))

    def _values(self, part: str, settings: np.ndarray) -> np.ndarray:
        declared = len(self.kinds[part].settings)
        values: np.ndarray = settings[PARTS.index(part), :declared] if declared else NO_SETTINGS
        return values

    def name(self, part: str) -> str:
        """Return the name of the backend of ``part`` in events and errors."""
        return f"{part} {self.kinds[part].name}"

    def log_texts(self, t_s: float, state: np.record) -> None:
        """Log each text that is another one than in the cycle before."""
        for number, part in enumerate(ANY_PART, 1):
            text = printable(bytes(state[part]["text"])) if int(state["new_text"]) & 1 << number else ""
            if text and len(self.messages) < _MESSAGES_MAX:
                self.messages.append(Event(t_s, self.name(part), text))

    def hold_reason(self, state: np.record) -> str:
        """Return why the bench is to hold if a backend requests it."""
        part = ANY_PART[int(state["asks_for_hold"]) - 1]
        return hold_reason(self.name(part), bytes(state[part]["text"]))

    def failure(self, state: np.record) -> DeviceError:
        """Return the error of the backend that has failed. Raises KeyboardInterrupt if Ctrl-C has ended its step."""
        part = ANY_PART[int(state["failed"]) - 1]
        instance, error, message = self._instances.get(part), None, b""
        if instance is not None and state["fault"] == backend_outputs.RETURNED:
            error, message = instance.error_of(state[f"{part}_input"], state[f"{part}_output"]), instance.message
        if isinstance(error, KeyboardInterrupt):
            raise error
        self.user_error = None if isinstance(error, ProtocolError) else error
        return failure_of(self.name(part), state, int(self.setup.n_thrusters), error, message)


class CompiledGnc(GncBackend):
    """GNC whose step is one compiled call, of the compiled loop as well. params: GNC_PARAMS.

    state: GNC_STATE of the loop; None: of its own.
    """

    def __init__(
        self, params: np.record, backends: OpenBackends, event_log: ApproachEventLog, state: np.record | None
    ) -> None:
        self.params = kernel_record(params)
        self.state = kernel_record(new(GNC_STATE) if state is None else state)
        super().__init__(params.approach, self.state.approach, event_log)
        self._backends = backends
        self.memory = new_memory(params.navigation.fusion)
        """Of the filters, of ``step_memory.new_memory``."""

    @property
    def event_logs(self) -> tuple[ObservableList[Event], ...]:
        """Lists of events: of the approach and of backends."""
        return (self.event_log.events, self._backends.messages)

    @property
    def user_error(self) -> BaseException | None:
        """What a Python object of the user has raised."""
        return self._backends.user_error

    def open(self, bench_s: float) -> None:
        """Open the backends. Raises BadInput or DeviceError."""
        self._backends.open(self.state["backends"], self.params["settings"])

    def close(self) -> None:
        """Close the backends."""
        self._backends.close(self.state["backends"])

    def set_sensor_arrivals(self, arrivals: np.ndarray) -> None:
        """Take the samples of further sensors of the next cycle, (n,) of SENSOR_ARRIVAL."""
        inbox = self.state.navigation.fusion.sensors
        inbox.arrived = len(arrivals)
        inbox.arrival[: len(arrivals)] = arrivals

    def add_innovations(self, cycle: int, nis_position: float, nis_attitude: float) -> None:
        """Check the NIS of ``cycle``, in which poses arrived; those of filters elsewhere are not monitored."""

    def log_step(self, t_s: float, before: bytes, supervision: np.record) -> None:
        """Log the progress since ``before`` (bytes of APPROACH_PROGRESS) and new texts of backends."""
        self.log_progress(t_s, before, supervision)
        self.log_texts(t_s)

    def log_texts(self, t_s: float) -> None:
        """Log the new texts of backends."""
        if self._backends.kinds and self.state["backends"]["new_text"]:
            self._backends.log_texts(t_s, self.state["backends"])

    def hold_as_asked(self) -> None:
        """Request the hold for which a backend has asked."""
        self.request_hold(self._backends.hold_reason(self.state["backends"]))

    def fail(self, t_s: float, before: bytes, supervision: np.record) -> NoReturn:
        """Log the step in which a backend has failed; raise its failure."""
        self.log_step(t_s, before, supervision)
        raise self._backends.failure(self.state["backends"])
