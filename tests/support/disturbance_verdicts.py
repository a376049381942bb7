"""Expectations and verdicts on rows of disturbances, of the vision unit and of the docking monitor."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
WITHIN = (0.90, 0.98)
"""Fraction of the errors within two of their sigmas; 0.954 for normal errors."""
NAMED = 0.9
"""Least fraction of the refused images whose status names the cause."""


@dataclass(frozen=True)
class Expectation:
    """What a user may expect of a row.

    solved: least fraction of images with a result. refused: statuses that name the cause, of a row whose images should
    give no result unless it is right within its sigmas. drawn: whether the errors are drawn from the tolerances that
    are stated; where the real error is smaller or always the same, sigmas may be too wide.
    """

    solved: float = 0.95
    refused: tuple[str, ...] = ()
    drawn: bool = True


USUAL_ROW = Expectation()


@dataclass
class SeedResult:
    """Results of a row with one seed. ratios: errors over sigmas of all values. costs_s: processor time per image."""

    frames: int = 0
    solved: int = 0
    gross: int = 0
    statuses: dict[str, int] = field(default_factory=dict)
    ratios: list[float] = field(default_factory=list)
    costs_s: list[float] = field(default_factory=list)


@dataclass(frozen=True)
class Verdict:
    """A row over all its seeds. why: what is not as expected, "" if it passed."""

    frames: int
    solved: tuple[int, ...]
    gross: int
    rms: float
    largest: float
    within: float
    refused: dict[str, int]
    why: str


def judge(expected: Expectation, results: Sequence[SeedResult]) -> Verdict:
    """Return the verdict on the results of a row."""
    ratios = np.abs(np.concatenate([np.array(one.ratios, dtype=float) for one in results]))
    frames, solved = sum(one.frames for one in results), tuple(one.solved for one in results)
    gross = sum(one.gross for one in results)
    statuses: Counter[str] = Counter()
    for one in results:
        statuses.update(one.statuses)
    refused = {name: count for name, count in statuses.most_common() if name not in ("ok", "near", "far")}
    within = float(np.mean(ratios < 2.0)) if len(ratios) else np.nan
    faults = [f"{gross} gross errors"] if gross else []
    if expected.refused:
        named = sum(count for name, count in refused.items() if name in expected.refused)
        if named < NAMED * sum(refused.values()) or not refused:
            faults.append(f"less than {100.0 * NAMED:.0f} % of the refused images name the cause")
    elif sum(solved) < expected.solved * frames:
        faults.append(f"less than {100.0 * expected.solved:.0f} % solved")
    if within < WITHIN[0]:
        faults.append(f"less than {100.0 * WITHIN[0]:.0f} % within 2 sigma")
    elif expected.drawn and not expected.refused and within > WITHIN[1]:
        faults.append(f"more than {100.0 * WITHIN[1]:.0f} % within 2 sigma")
    rms = float(np.sqrt(np.mean(ratios**2))) if len(ratios) else np.nan
    largest = float(ratios.max()) if len(ratios) else np.nan
    return Verdict(frames, solved, gross, rms, largest, within, refused, ", ".join(faults))
