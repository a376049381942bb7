"""Observed poses of a bench: one row per pose and source of a CSV file.

``tracker``: the chaser's body c relative to the target's, H: position in H, rotation vector from H to c, as
``q_CH``. ``vmu``: the LED ring relative to the left camera, ``t_v``, rotation vector of ``q_vt``.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from hil.core.csv_table import read_csv
from hil.core.files import MIB, write_text
from hil.core.messages import Array

SOURCES: Final = ("tracker", "vmu")
BODIES: Final = {"tracker": "chaser", "vmu": "ring"}
AXIS_COLUMNS: Final = ("x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad")
_POSE: Final = ("r_x_m", "r_y_m", "r_z_m", "phi_x_rad", "phi_y_rad", "phi_z_rad")
_SIGMAS: Final = tuple(f"sigma_{name}" for name in _POSE)
_NUMBERS: Final = (*AXIS_COLUMNS, *_POSE, *_SIGMAS)
COLUMNS: Final = ("pose", *_NUMBERS, "source", "body")
_FILE_BYTES: Final = 16 * MIB


@dataclass(frozen=True)
class PoseObservations:
    """n observations. pose: (n,), number of the place. axes: (n, 6), encoders, m and rad. value: (n, 6), position, m,
    and rotation vector, rad. sigma: (n, 6). source: of each."""

    pose: np.ndarray
    axes: Array
    value: Array
    sigma: Array
    source: np.ndarray

    def __len__(self) -> int:
        return len(self.pose)

    def of(self, chosen: np.ndarray) -> PoseObservations:
        """Return those that are ``chosen``, a mask or numbers."""
        return PoseObservations(*(each[chosen] for each in (self.pose, self.axes, self.value, self.sigma, self.source)))


def joined(rows: list[PoseObservations]) -> PoseObservations:
    """Return all of ``rows``."""
    return PoseObservations(*(np.concatenate(each) for each in zip(*(vars(row).values() for row in rows), strict=True)))


def write_observations(observations: PoseObservations, path: str) -> None:
    """Write a CSV file. Raises BadInput if it cannot be written."""
    numbers = np.hstack([observations.axes, observations.value, observations.sigma])
    sources = [str(source) for source in observations.source]
    rows = zip(observations.pose, numbers, sources, strict=True)
    write_table(path, COLUMNS, ([int(n), *map(_text, row), source, BODIES[source]] for n, row, source in rows))


def write_table(path: str, columns: Sequence[str], rows: Iterable[Sequence[object]], before: str = "") -> None:
    """Write a CSV file, or append ``rows`` to the text ``before`` of one. Raises BadInput if it cannot be written."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([*([] if before else [columns]), *rows])
    write_text(before + text.getvalue(), path)


def _text(value: float) -> str:
    return f"{value:.9g}"


def read_observations(path: str) -> PoseObservations:
    """Return the observations of a CSV file; raise BadInput."""
    table = read_csv(Path(path), _FILE_BYTES, COLUMNS, what="pose")
    values = []
    for line, row in table.rows:
        numbers = [table.number(line, name, row[name]) for name in _NUMBERS]
        if row["source"] not in SOURCES or row["body"] != BODIES[row["source"]]:
            text = f"{row['source']!r}, {row['body']!r}: allowed tracker, chaser or vmu, ring"
            table.note(f"line {line}, source, body", text)
        if any(not sigma > 0.0 for sigma in numbers[12:]):
            table.note(f"line {line}", "a sigma is not above 0")
        values.append(numbers)
    table.check()
    axes, value, sigma = np.split(np.array(values), 3, axis=1)
    pose = np.array([row["pose"] for _, row in table.rows])
    numbers_of = {name: number for number, name in enumerate(dict.fromkeys(pose.tolist()))}
    return PoseObservations(
        np.array([numbers_of[name] for name in pose.tolist()]),
        axes,
        value,
        sigma,
        np.array([row["source"] for _, row in table.rows]),
    )
