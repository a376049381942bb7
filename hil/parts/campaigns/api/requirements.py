"""Requirements on a run, checked in each of its cycles: ``hil.RunRequirement``, and the files with their evidence."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np
import scipy  # its parts are imported when they are used

from hil.api.results import Run
from hil.core.messages import CYCLE, Array
from hil.errors import BadInput
from hil.parts.campaigns.campaign import write_evidence
from hil.parts.campaigns.requirements_page import VERIFIED, EvidenceRow
from hil.recording.schema import present_column

NOT_VERIFIED, NOT_REACHED = "not verified", "not reached"
_FIELD: Final = re.compile(r"(\w+)(?:\.(\w+))?(?:\[(\d+)\])?")


@dataclass(frozen=True)
class RunRequirement:
    """Limit on a quantity of each cycle that may be exceeded for a time only: never more than x for 60 s.

    Parameters
    ----------
    id
        Identifier, as in the specification.
    text
        Wording.
    quantity
        Column of ``hil export``, as ``truth.r_CT_H[1]``, between bars for its absolute value; or a function of the run
        that returns an array (n,), one number per cycle.
    at_most, at_least
        Limit, one of both, in the unit of the quantity.
    for_s
        Time in which the limit may be exceeded without a break, s; 0: in no cycle.
    from_s
        Time of the run from which it holds, s, or ``ready``: from the start of the ready phase.

    Raises
    ------
    BadInput
        An unknown column, or invalid numbers.
    """

    id: str
    text: str
    quantity: str | Callable[[Run], Array]
    at_most: float | None = None
    at_least: float | None = None
    for_s: float = 0.0
    from_s: float | Literal["ready"] = 0.0

    def __post_init__(self) -> None:
        limits = [limit for limit in (self.at_most, self.at_least) if limit is not None]
        if len(limits) != 1 or not math.isfinite(limits[0]):
            raise BadInput.single(self.id, "", "at_most and at_least: one of them must be given, a finite number")
        if not (math.isfinite(self.for_s) and self.for_s >= 0.0):
            raise BadInput.single(self.id, "for_s", f"{self.for_s!r}: must be a time of 0 s or more")
        if self.from_s != "ready" and not (isinstance(self.from_s, int | float) and math.isfinite(self.from_s)):
            raise BadInput.single(self.id, "from_s", f'{self.from_s!r:.40}: must be a time, or "ready"')
        if isinstance(self.quantity, str):
            self._column(np.zeros(1, CYCLE))
        elif not callable(self.quantity):
            raise BadInput.single(self.id, "quantity", f"{self.quantity!r:.40}: must be a column or a function")

    def _column(self, history: np.ndarray) -> Array:
        """Return the column of ``history`` that a text names. Raises BadInput."""
        text = str(self.quantity).strip()
        absolute = len(text) > 2 and text[0] == text[-1] == "|"
        match = _FIELD.fullmatch(present_column(text[1:-1] if absolute else text))
        values, names = history, ", ".join(CYCLE.names or ())
        for name in match.groups()[:2] if match else (text,):
            if name is None:
                continue
            if name not in (values.dtype.names or ()):
                raise BadInput.single(self.id, "quantity", f"{text:.60}: no such column, known here: {names}")
            values = values[name]
            names = ", ".join(values.dtype.names or ())
        shape, index = values.shape[1:], match[3] if match else None
        fits = index is None if not shape else index is not None and len(shape) == 1 and int(index) < shape[0]
        if values.dtype.names or not fits:
            form = f"[0] to [{shape[0] - 1}]" if len(shape) == 1 else f"one of its fields: {names}" if names else "none"
            raise BadInput.single(self.id, "quantity", f"{text:.60}: must be a number of each cycle, index {form}")
        column = np.asarray(values if index is None else values[:, int(index)], dtype=float)
        return np.abs(column) if absolute else column

    @property
    def limit_text(self) -> str:
        """Quantity, limit and times as text."""
        name = self.quantity if isinstance(self.quantity, str) else getattr(self.quantity, "__name__", "quantity")
        limit = f"at most {self.at_most:g}" if self.at_most is not None else f"at least {self.at_least:g}"
        longest = f", exceeded for {self.for_s:g} s at most" if self.for_s else ""
        begin = ", in the ready phase" if self.from_s == "ready" else f", from {self.from_s:g} s" if self.from_s else ""
        return f"{name} {limit}{longest}{begin}"

    def check(self, run: Run) -> EvidenceRow:
        """Return the evidence of ``run``: result, margin and status.

        The margin is at the value that is exceeded for ``for_s``; a value that is not a number exceeds all limits.
        Raises BadInput if the quantity has not one number per cycle.
        """
        evidence = f"run of {run.summary['scenario']} on {run.summary['rig']}, seed {run.summary['seed']}, {run.stop}"
        wording = f"{self.text} ({self.limit_text})"
        row = EvidenceRow(self.id, wording, run.rig.kind, "test", evidence, NOT_REACHED, None, NOT_VERIFIED)
        from_s = run.ready_time_s if self.from_s == "ready" else self.from_s
        sign, limit = (1.0, self.at_most) if self.at_most is not None else (-1.0, self.at_least)
        assert limit is not None
        if from_s is None:
            return row
        values = sign * self._values(run)[run.t_s >= from_s - 0.5 * run.scenario.step_s]
        window = round(self.for_s / run.scenario.step_s) + 1
        if len(values) < window:
            return row
        exceeded = np.where(np.isnan(values), np.inf, values)
        held = float(scipy.ndimage.minimum_filter1d(exceeded, window, mode="constant", cval=-np.inf).max())
        longest_s = _longest(exceeded > sign * limit) * run.scenario.step_s
        margin = sign * limit - held if math.isfinite(held) else None
        result = f"{'largest' if sign > 0.0 else 'smallest'} {sign * held:.5g}, limit exceeded for {longest_s:.4g} s"
        status = VERIFIED if margin is not None and margin >= 0.0 else NOT_VERIFIED
        return row._replace(result=result, margin=margin, status=status)

    def _values(self, run: Run) -> Array:
        if isinstance(self.quantity, str):
            return self._column(run.history)
        values = np.asarray(self.quantity(run), dtype=float)
        if values.shape != run.t_s.shape:
            text = f"returned an array {values.shape}, must be {run.t_s.shape}, one number per cycle"
            raise BadInput.single(self.id, "quantity", text)
        return values


def _longest(exceeded: np.ndarray) -> int:
    """Return the length of the longest sequence of True in ``exceeded``, (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], exceeded, [False]]).astype(int)))
    return int((edges[1::2] - edges[::2]).max(initial=0))


def write_run_evidence(folder: str | Path, run: Run, rows: Sequence[EvidenceRow]) -> None:
    """Write ``requirements.html``, ``.xml`` and ``.json`` with a run's evidence into ``folder``. Raises BadInput."""
    target = Path(folder)
    try:
        target.mkdir(parents=True, exist_ok=True)
        sources = {"run": repr(run)[1:-1], "rig": f"{run.summary['rig']}, {run.rig.kind}"}
        write_evidence(target, run.scenario.name, sources, rows)
    except OSError as error:
        raise BadInput.single(str(folder), "", f"cannot be written: {error.strerror}") from error
