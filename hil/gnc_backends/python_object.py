"""GNC as a Python object: its ``step`` is called in the loop's own thread, in this process."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, Protocol, runtime_checkable

import numpy as np

from hil.core.gnc_records import GNC_OUTPUT
from hil.errors import DeviceError, ProtocolError
from hil.gnc_backends import external_records
from hil.gnc_backends.external import BackendSetup, ExternalGnc, raised_text

_ESTIMATE: Final = frozenset({"r_CT_H_m", "v_CT_H_mps", "q_CH", "w_CH_C_radps"})
_REALS: Final = _ESTIMATE | {"protection_level_m", "protection_level_rad"}
_INTEGERS: Final = range(-100, 101)  # of demands and states; the allowed ones are checked with the record
_FIELDS: Final = tuple(name for name in GNC_OUTPUT.names or () if name not in ("cycle", "direct", "estimate"))


@runtime_checkable
class PythonGnc(Protocol):
    """GNC as an object. It may also have ``reset()`` and ``start(setup)``, which are called when a session begins.

    setup: record with the fields of ``hil_gnc_setup`` in ``hil_gnc.h``: nominal vehicle, thrusters and plan.
    """

    def step(self, gnc_input: Any, /) -> Any:
        """Return the thrusters of this cycle.

        gnc_input: record with the fields of ``hil_gnc_input`` in ``hil_gnc.h`` as attributes, SI; of ``poses`` the
        first ``n_poses`` came since the last cycle. It may be kept. The result is None to coast, or a sequence with
        one number per thruster, 1 open and 0 closed, or a mapping with fields of ``hil_gnc_output``: ``on``; or
        ``force`` and ``torque``, (3,) each of -1, 0, 1, which the bench allocates; the four fields of an estimate
        (``r_CT_H_m``, ``v_CT_H_mps``, ``q_CH``, ``w_CH_C_radps``) and, with it, ``protection_level_m``,
        ``protection_level_rad`` and ``health``; ``state``; ``text``, a message for the operator.
        """


class PythonObjectGnc(ExternalGnc):
    """Calls ``gnc`` in each cycle of the closed loop; what it raises stops the bench with its class and text."""

    def __init__(self, gnc: PythonGnc, setup: BackendSetup) -> None:
        super().__init__(f"gnc {class_name(gnc)}", setup)
        self._gnc = gnc
        self._raised: BaseException | None = None

    @property
    def user_error(self) -> BaseException | None:
        """What the object has raised."""
        return self._raised

    def open(self, bench_s: float) -> None:
        """Begin a session: call ``reset()`` and ``start(setup)`` of the object if it has them. Raises DeviceError."""
        for name, arguments in (("reset", ()), ("start", (self.setup.copy(),))):
            method = getattr(self._gnc, name, None)
            if method is not None:
                self._call(name, method, *arguments)

    def exchange(self) -> bool:
        """Call ``step`` and check what it returns. Raises DeviceError, ProtocolError."""
        found = self._call("step", self._gnc.step, self.input.copy())
        external_records.clear_output(self.output, self.input.cycle)
        self.output.text = b""
        if isinstance(found, Mapping):
            self._read_fields(found)
        elif found is not None:
            self._read_thrusters(found)
        return True

    def _call(self, name: str, method: Any, *arguments: Any) -> Any:
        try:
            return method(*arguments)
        except Exception as error:
            self._raised = error
            raise DeviceError(self.name, raised_text(name, error)) from error

    def _read_fields(self, found: Mapping[str, Any]) -> None:
        for name, value in found.items():
            if name not in _FIELDS:
                raise ProtocolError(self.name, f"step returned the field {name!r}, allowed {', '.join(_FIELDS)}")
            if name == "on":
                self._read_thrusters(value)
            elif name == "text":
                self.output.text = str(value).encode()[: GNC_OUTPUT["text"].itemsize]
            elif name == "state":
                self.output.state = int(self._numbers(name, value, (), whole=True))
            else:
                self.output[name] = self._numbers(name, value, GNC_OUTPUT[name].shape, whole=name not in _REALS)
        estimate = _ESTIMATE & set(found)
        if estimate and estimate != _ESTIMATE:
            missing = ", ".join(sorted(_ESTIMATE - estimate))
            raise ProtocolError(self.name, f"step returned an estimate without {missing}")
        self.output.estimate = bool(estimate)

    def _read_thrusters(self, found: Any) -> None:
        on = self._numbers("thrusters", found, (self._n,), whole=False)
        if bad := [i for i, value in enumerate(on) if value not in (0.0, 1.0)]:
            raise ProtocolError(self.name, f"thruster {bad[0] + 1} is {on[bad[0]]:g}, allowed 0, 1")
        self.output.direct = 1
        self.output.on[: self._n] = on

    def _numbers(self, name: str, value: Any, shape: tuple[int, ...], whole: bool) -> np.ndarray:
        """Return ``value`` as an array of ``shape``; raise ProtocolError for anything else."""
        try:
            numbers = np.asarray(value, dtype=float)
        except (TypeError, ValueError) as error:
            raise ProtocolError(self.name, f"{name}: {value!r:.60}, allowed {_shown(shape)}") from error
        if numbers.shape != shape:
            raise ProtocolError(self.name, f"{name}: {_shown(numbers.shape)}, allowed {_shown(shape)}")
        if whole and not all(value in _INTEGERS for value in numbers.flat):
            raise ProtocolError(self.name, f"{name}: {numbers.tolist()}, allowed integers")
        return numbers


def class_name(gnc: object) -> str:
    """Return the name of an object's class, as it appears in events, errors and the report."""
    return type(gnc).__name__


def _shown(shape: tuple[int, ...]) -> str:
    return f"{shape[0]} numbers" if shape else "one number"
