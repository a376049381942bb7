"""Observed poses of a bench: one row per pose and source of a CSV file.

``tracker``: the chaser's body c relative to the target's, H: position in H, rotation vector from H to c, as
``q_CH``. ``vmu``: the LED ring relative to the left camera, ``t_v``, rotation vector of ``q_vt``.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from hil.core.files import MIB, read_text, write_text
from hil.core.messages import Array
from hil.errors import BadInput, Problem

SOURCES: Final = ("tracker", "vmu")
BODIES: Final = {"tracker": "chaser", "vmu": "ring"}
AXIS_COLUMNS: Final = ("x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad")
_POSE: Final = ("r_x_m", "r_y_m", "r_z_m", "phi_x_rad", "phi_y_rad", "phi_z_rad")
_SIGMAS: Final = tuple(f"sigma_{name}" for name in _POSE)
_NUMBERS: Final = (*AXIS_COLUMNS, *_POSE, *_SIGMAS)
COLUMNS: Final = ("pose", *_NUMBERS, "source", "body")
_FILE_BYTES: Final = 16 * MIB
_PROBLEMS_MAX: Final = 5


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


def read_table(path: str, columns: Sequence[str]) -> Iterator[tuple[int, dict[str, str]]]:
    """Yield line number and cells of the ``columns`` of each row of a CSV file; raise BadInput."""
    reader = csv.DictReader(io.StringIO(read_text(Path(path), _FILE_BYTES)), skipinitialspace=True)
    header = [name.strip() for name in reader.fieldnames or ()]
    if missing := [name for name in columns if name not in header]:
        raise BadInput.single(path, "", f"column {missing[0]} is missing; columns: {','.join(columns)}")
    for line, row in enumerate(reader, start=2):
        yield line, {name: (row[name] or "").strip() for name in columns}


def read_observations(path: str) -> PoseObservations:
    """Return the observations of a CSV file; raise BadInput."""
    rows = list(read_table(path, COLUMNS))
    problems: list[Problem] = []
    values = []
    for line, row in rows:
        numbers = [_number(path, line, name, row[name], problems) for name in _NUMBERS]
        if row["source"] not in SOURCES or row["body"] != BODIES[row["source"]]:
            text = f"{row['source']!r}, {row['body']!r}: allowed tracker, chaser or vmu, ring"
            problems.append(Problem(path, f"line {line}, source, body", text))
        if any(not sigma > 0.0 for sigma in numbers[12:]):
            problems.append(Problem(path, f"line {line}", "a sigma is not above 0"))
        values.append(numbers)
    if not rows:
        problems.append(Problem(path, "", "contains no pose"))
    if problems:
        raise BadInput(problems[:_PROBLEMS_MAX])
    axes, value, sigma = np.split(np.array(values), 3, axis=1)
    pose = np.array([row["pose"] for _, row in rows])
    numbers_of = {name: number for number, name in enumerate(dict.fromkeys(pose.tolist()))}
    return PoseObservations(
        np.array([numbers_of[name] for name in pose.tolist()]),
        axes,
        value,
        sigma,
        np.array([row["source"] for _, row in rows]),
    )


def _number(path: str, line: int, column: str, text: str, problems: list[Problem]) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        problems.append(Problem(path, f"line {line}, {column}", f"{text!r}: must be a finite number"))
    return value
