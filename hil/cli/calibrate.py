"""``hil calibrate``: cameras, stereo, mounting and LED layout from views at known places of the bench; drift check."""

from __future__ import annotations

import datetime
import math
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console

from hil.cli.output import base_of, check_json_path, check_picture_path, check_rig_path, write_json
from hil.cli.progress import Bar
from hil.config.load import load_geometry, load_rig
from hil.errors import BadInput, Problem
from hil.vmu.geometry import geometry_of_rig

if TYPE_CHECKING:
    from hil.vmu.calibration.board import Board

_PASSED, _FAILED = 0, 1
_PARTS = ("left", "right", "stereo", "mounting", "leds")


@dataclass(frozen=True, slots=True)
class Options:
    """What the command line says; as in ``hil calibrate --help``."""

    views: str
    check: str | None
    board: str | None
    square_mm: float | None
    rig: str
    geometry: str | None
    keep: tuple[str, ...]
    moved: bool
    out: str | None
    rig_out: str | None
    json: str | None
    figure: str | None
    id: str | None
    date: str | None
    rail_sigma_mm: float
    gimbal_sigma_deg: float
    led_sigma_mm: float
    square_sigma_percent: float
    max_rms_px: float
    max_error_mm: float
    range_m: float
    max_mounting_mm: float
    max_mounting_deg: float
    max_square_percent: float
    max_drift_px: float
    alarm: float
    settings: tuple[str, ...]


def calibrate_command(options: Options) -> int:
    """Do ``hil calibrate``; return its exit code. Raises BadInput where nothing can be found."""
    _check_options(options)
    return _calibrate(options) if options.check is None else _check(options)


def _calibrate(options: Options) -> int:
    rig = load_rig(options.rig, options.settings)
    from hil.vmu.calibration import job
    from hil.vmu.calibration.files import Label, as_toml, geometry_table, rig_table
    from hil.vmu.calibration.views import read_views

    if options.geometry is not None:
        geometry = load_geometry(options.geometry).value
    else:
        geometry = geometry_of_rig(rig.value)
    board = _board(options)
    views = read_views(Path(options.views))
    sigma = np.array([1e-3 * options.rail_sigma_mm] * 3 + [math.radians(options.gimbal_sigma_deg)] * 3)
    given = job.Given(board, options.keep, sigma, 1e-3 * options.led_sigma_mm, 0.01 * options.square_sigma_percent)
    limits = job.CalibrationLimits(
        options.max_rms_px,
        options.max_error_mm,
        options.range_m,
        options.max_mounting_mm,
        options.max_mounting_deg,
        options.max_square_percent,
    )
    date = options.date or datetime.datetime.now().astimezone().date().isoformat()
    label = Label(options.id or f"vmu-{date}", date, job.target_name(board))
    with Bar(Console(stderr=True), "reading the views") as bar:
        guess = options.geometry is not None
        outcome = job.calibrate(views, rig.value, geometry, given, limits, label, guess, bar.tell)
    fit = outcome.solved.fit
    if options.out is not None:
        used = len(outcome.solved.sightings.names)
        table = geometry_table(label, fit, outcome.turntable, sigma, geometry, used)
        _write(options.out, as_toml(table, "Vision unit: LEDs and cameras, as hil calibrate found them."))
    if options.rig_out is not None:
        content = {"extends": base_of(options.rig, options.rig_out), **rig_table(fit.setup, board is None)}
        _write(options.rig_out, as_toml(content, f"Mounting of the cameras, from calibration {label.id}."))
    from hil.vmu.calibration.report import as_json

    if options.json is not None:
        write_json(as_json(outcome), options.json)
    if options.figure is not None:
        from hil.vmu.calibration.figure import draw

        draw(outcome, options.figure)
    if options.json != "-":
        from hil.cli.calibrate_tables import print_outcome

        print_outcome(outcome, Console())
    return _PASSED if outcome.passed else _FAILED


def _check(options: Options) -> int:
    from hil.vmu.calibration import job
    from hil.vmu.calibration.files import read_back
    from hil.vmu.calibration.views import read_views

    assert options.check is not None
    known = read_back(load_geometry(options.check).value, options.check)
    views = read_views(Path(options.views))
    with Bar(Console(stderr=True), "reading the views") as bar:
        checked = job.check(views, known, _board(options), options.moved, options.range_m, bar.tell)
    limits = {"rms_px": options.max_rms_px, "drift_px": options.max_drift_px, "alarm": options.alarm}
    found = checked.drift
    drifted = found.chance < options.alarm and found.explanations[0].shift_px > options.max_drift_px
    passed = not drifted and found.rms_px <= options.max_rms_px
    if options.json is not None:
        from hil.vmu.calibration.report import drift_as_json

        write_json(drift_as_json(checked, passed, limits), options.json)
    if options.json != "-":
        from hil.cli.calibrate_tables import print_check

        print_check(checked, passed, limits, Console())
    return _PASSED if passed else _FAILED


def _write(path: str, text: str) -> None:
    """Write the whole file or none of it."""
    partial = Path(f"{path}.part")
    partial.write_text(text, encoding="utf-8")
    os.replace(partial, path)


def _board(options: Options) -> Board | None:
    from hil.vmu.calibration.board import Board

    if options.board is None or options.square_mm is None:
        return None
    columns, rows = (int(word) for word in options.board.split("x"))
    return Board(columns, rows, 1e-3 * options.square_mm)


def _check_options(options: Options) -> None:
    problems: list[Problem] = []
    positive = (
        "square_mm rail_sigma_mm gimbal_sigma_deg led_sigma_mm square_sigma_percent max_rms_px max_error_mm range_m "
        "max_mounting_mm max_mounting_deg max_square_percent max_drift_px alarm"
    )
    for name in positive.split():
        value = getattr(options, name)
        if value is not None and not (math.isfinite(value) and value > 0.0):
            problems.append(Problem(f"--{name.replace('_', '-')}", "", f"{value:g}: must be above 0"))
    problems += _board_problems(options.board, options.square_mm)
    problems += [
        Problem("--keep", "", f"{part}: unknown, give {', '.join(_PARTS)}")
        for part in options.keep
        if part not in _PARTS
    ]
    if options.date is not None and not _is_date(options.date):
        problems.append(Problem("--date", "", f"{options.date}: must be a date like 2026-03-01"))
    if options.check is not None:
        given = [n for n in ("geometry", "keep", "out", "rig_out", "figure") if getattr(options, n)]
        problems += [Problem("--check", "", f"goes without --{name.replace('_', '-')}") for name in given]
    elif options.moved:
        problems.append(Problem("--moved", "", "goes with --check alone"))
    problems += check_rig_path("--out", options.out) + check_rig_path("--rig-out", options.rig_out)
    problems += check_json_path("--json", options.json) + check_picture_path("--figure", options.figure)
    if problems:
        raise BadInput(problems)


def _board_problems(board: str | None, square_mm: float | None) -> Sequence[Problem]:
    if board is None:
        return [Problem("--square-mm", "", "goes with --board alone")] if square_mm is not None else []
    found = re.fullmatch(r"(\d{1,2})x(\d{1,2})", board)
    if found is None:
        return [Problem("--board", "", f"{board}: must be COLUMNSxROWS of inner corners, as 11x8")]
    columns, rows = (int(word) for word in found.groups())
    if columns == rows or min(columns, rows) < 3:
        text = "columns and rows must be at least 3 and differ, or the board could lie any way round"
        return [Problem("--board", "", f"{board}: {text}")]
    return [Problem("--square-mm", "", "is missing: the side of a square, measured")] if square_mm is None else []


def _is_date(text: str) -> bool:
    try:
        datetime.date.fromisoformat(text)
    except ValueError:
        return False
    return True
