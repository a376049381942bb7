"""Geometry file of a bench, as ``hil geometry fit`` writes it; errors of a rig, as measured and as built."""

from __future__ import annotations

import hashlib
import json
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from hil.config.load import check_table, read_with_bases
from hil.config.rig import Rig
from hil.config.tables.machine import NAMES, PARAMETERS, MachineErrors, MachineGeometry
from hil.config.tables.model import ConfigModel, NotNegative
from hil.config.tables.sign_off import Day, Digest
from hil.core.messages import Array
from hil.errors import BadInput

_NO_ERRORS = MachineErrors()


class HeldOut(ConfigModel):
    """Poses that the fit has not used: residuals after it."""

    poses: Annotated[int, Field(ge=0)]
    """Their number."""
    rms_m: NotNegative
    """Position, rms over all components."""
    rms_deg: NotNegative
    """Attitude, rms over all components."""
    chi_square: NotNegative
    """Their weighted squares, with the covariance of the fit."""


class BenchGeometryFile(ConfigModel):
    """Geometry of one bench."""

    format: Literal["hil bench geometry 1"]
    """Kind of file, and its version."""
    date: Day
    """Date of the measurement."""
    digest: Digest
    """Of all other content."""
    rig: Digest
    """Of the rig file's geometry, from which the parameters are the differences."""
    source: tuple[str, ...]
    """Sources of the observations: tracker, vmu."""
    poses: Annotated[int, Field(ge=1)]
    """Poses of the fit, those of ``held_out`` and rejected ones not among them."""
    rejected: Annotated[int, Field(ge=0)] = 0
    """Gross errors."""
    held_out: HeldOut
    parameters: MachineGeometry
    not_observed: tuple[str, ...] = ()
    """Parameters that the observations do not determine: left at zero, not guessed."""
    covariance: tuple[tuple[float, ...], ...] = ()
    """Lower triangle over the observed parameters, in their order, m and rad."""

    @model_validator(mode="after")
    def _is_complete(self) -> Self:
        if unknown := [name for name in self.not_observed if name not in NAMES]:
            raise ValueError(f"not_observed: {unknown[0]} is no parameter")
        observed = PARAMETERS - len(self.not_observed)
        if [len(row) for row in self.covariance] != list(range(1, observed + 1)):
            raise ValueError(f"covariance: must be the lower triangle of {observed} observed parameters")
        return self

    @property
    def observed(self) -> list[int]:
        """Numbers of the parameters that are observed."""
        return [k for k, name in enumerate(NAMES) if name not in self.not_observed]

    @property
    def covariance_matrix(self) -> Array:
        """Covariance of all parameters, (PARAMETERS, PARAMETERS), m and rad; zeros for those not observed."""
        matrix, places = np.zeros((PARAMETERS, PARAMETERS)), self.observed
        for i, row in zip(places, self.covariance, strict=True):
            for j, value in zip(places, row, strict=False):
                matrix[i, j] = matrix[j, i] = value
        return matrix


def content_digest(table: dict[str, Any]) -> str:
    """Return the digest of the content of a geometry file, ``table``, as JSON, without its own."""
    content = {key: value for key, value in table.items() if key != "digest"}
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return f"sha256:{hashlib.sha256(text.encode()).hexdigest()}"


def nominal_digest(rig: Rig) -> str:
    """Return the digest of what the parameters are differences from: arms, mountings, travel and order of the axes."""
    bench = rig.bench.model_dump(
        mode="json",
        include={"lever_arm_m", "gimbal_order", "rails_order", "camera_position_m", "camera_axes"}
        | {"led_ring_position_m", "led_ring_axes", "lab_axes"},
    )
    travel = [list(axis.in_file("travel")) for axis in (*rig.rails.axes, *rig.turntable.axes)]
    return content_digest({**bench, "travel": travel})


def load_bench_geometry(path: str) -> BenchGeometryFile:
    """Return the geometry file at ``path``; raise BadInput. An unchanged file is not read again."""
    try:
        stamp = Path(path).stat()
    except OSError as error:
        raise BadInput.single(path, "", f"cannot be read: {error.strerror}") from error
    return _load(path, stamp.st_mtime_ns, stamp.st_size)


@lru_cache(maxsize=8)
def _load(path: str, _changed_ns: int, _size: int) -> BenchGeometryFile:
    table = read_with_bases(Path(path), "geometries", BenchGeometryFile, {})
    geometry = check_table(table, BenchGeometryFile, path).value
    if (digest := content_digest(geometry.model_dump(mode="json"))) != geometry.digest:
        text = f"{geometry.digest[:15]}...: the content has {digest[:15]}...: it was edited, run hil geometry fit"
        raise BadInput.single(path, "digest", text)
    return geometry


def measured_errors(rig: Rig) -> Array | None:
    """Return the parameters of the geometry file, (PARAMETERS,), None without one.

    Raises BadInput if it cannot be read, and if it is of a bench with other arms, mountings or travel.
    """
    geometry = geometry_of(rig)
    return None if geometry is None else geometry.parameters.vector


def geometry_of(rig: Rig) -> BenchGeometryFile | None:
    """Return the geometry file of ``rig``, None without one. Raises BadInput as ``measured_errors``."""
    path = rig.bench.geometry_file
    if path is None:
        return None
    geometry = load_bench_geometry(path)
    if geometry.rig != nominal_digest(rig):
        text = f"of {geometry.date}, of a bench with other arms, mountings or travel than {rig.name}: measure it again"
        raise BadInput.single(path, "rig", text)
    return geometry


def errors_as_built(rig: Rig, errors: MachineErrors = _NO_ERRORS) -> Array | None:
    """Return the parameters of the machine that a mock or emulated rig moves, None without errors.

    That of hardware is the measured one. errors: of the scenario. Raises BadInput as ``measured_errors``.
    """
    own = measured_errors(rig)
    if rig.kind == "hardware":
        return own
    if not rig.bench.errors.is_empty:
        own = rig.bench.errors.vector
    if errors.is_empty:
        return own
    return errors.vector if own is None else own + errors.vector
