"""Batch of cases, run by a worker: the unit of work of every engine."""

from __future__ import annotations

import hashlib
import json
import os
import pickle
import threading
import traceback
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final

from hil.config.load import Loaded, check_table
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.core.messages import Array
from hil.errors import BadInput
from hil.gnc_backends.backend import OwnBackends
from hil.gnc_backends.backend_registry import NO_BACKENDS, digest_of, named
from hil.gnc_backends.library import binary_digest
from hil.maths.random_streams import MixedSeed
from hil.parts.campaigns.dispersions import Design, case_seed
from hil.parts.campaigns.importance_density import LOG_WEIGHT, ImportanceDensity, block_normals
from hil.parts.campaigns.outcome import failed_row, row_of
from hil.parts.campaigns.python_cases import case_runner
from hil.parts.campaigns.sobol_indices import sobol_point

Batch = tuple[int, int]
"""First case, and how many."""
Rows = list[dict[str, Any]]
TRACEBACK: Final = "traceback"
"""Key of a row with the traceback of what a Python object of the user has raised; no column of the table."""
_here = threading.local()


@dataclass(frozen=True)
class Spec:
    """A campaign in a form that can be sent to any worker: scenario and rig as JSON text, with all files read.

    mixed: seeds of the cases of a rare-event campaign, by the case's number; others have the seed of their number.
    sobol: the cases belong to a campaign of Sobol' indices. density: text of the importance density of their noise.
    own: backends of navigation and control that the caller gives, pickled. code: digest of the files of GNC and
    sensors, which a worker reads by their paths.
    """

    scenario: str
    rig: str
    seed: int
    duration_s: float
    mixed: Mapping[int, MixedSeed] = field(default_factory=dict)
    sobol: bool = False
    density: str = ""
    own: bytes = b""
    code: str = ""

    @property
    def scenario_digest(self) -> str:
        """Digest of the scenario."""
        return hashlib.sha256(self.scenario.encode()).hexdigest()[:16]

    @classmethod
    def of(cls, scenario: Scenario, rig: Rig, seed: int, duration_s: float, own: OwnBackends = NO_BACKENDS) -> Spec:
        """Return the campaign of ``scenario`` on ``rig``. Raises BadInput if ``own`` cannot be sent to workers."""
        sent = pickled(own) if own != NO_BACKENDS else b""
        code = code_digest(scenario)
        return cls(scenario.model_dump_json(), rig.model_dump_json(), seed, duration_s, own=sent, code=code)


def code_digest(scenario: Scenario) -> str:
    """Return the digest of the files of GNC and sensors that ``scenario`` names."""
    sensors = [file for config in scenario.sensors.values() if (file := config.kind.rpartition(":")[0]).endswith(".py")]
    return " ".join(filter(None, [binary_digest(scenario.gnc), *map(digest_of, sensors)]))


def pickled(own: OwnBackends) -> bytes:
    """Return ``own`` for another process, also of a notebook. Raises BadInput if it cannot be sent."""
    try:
        import cloudpickle

        data: bytes = cloudpickle.dumps(own)
    except ImportError as error:
        text = (
            "an object flies in a campaign with cloudpickle, which is not installed: pip install 'hil-bench[campaign]'"
        )
        raise BadInput.single("campaign", "", text) from error
    except Exception as error:
        raise BadInput.single("campaign", "", f"a backend cannot be sent to other processes: {error}") from error
    return data


class Case:
    """Runs the cases of one ``Spec``; created once per worker, or thread of it.

    Raises BadInput if the files of GNC and sensors are not those that the campaign was begun with.
    """

    def __init__(self, spec: Spec) -> None:
        scenario: Loaded[Scenario] = check_table(json.loads(spec.scenario), Scenario, "campaign")
        self._rig = check_table(json.loads(spec.rig), Rig, "campaign").value
        self._spec = spec
        self.mixed: Mapping[int, MixedSeed] = spec.mixed
        own = pickle.loads(spec.own) if spec.own else NO_BACKENDS
        if code_digest(scenario.value) != spec.code:
            text = "files of GNC or sensors have changed since the campaign was begun, or are others on this computer"
            raise BadInput.single("campaign", "", text)
        scenario = named(scenario, own)
        self._design = Design(scenario, spec.seed)
        self.runner = case_runner(scenario.value, self._rig, spec.duration_s, own)
        self._density = ImportanceDensity.parse(spec.density) if spec.density else None

    def row(self, case: int) -> dict[str, Any]:
        """Run ``case``; return its row: dispersions and outcome, or the reason why it cannot be run."""
        values, seed = self._point(case)
        try:
            truth, gnc = self._design.apply(values, self._design.fault(case))
            if self._design.touches_gnc:
                self.runner.set_gnc_scenario(gnc)
            outcome = row_of(*self.runner.run(truth, seed), gnc, truth, self.runner.alarm)
        except Exception as error:  # one case must not end the campaign: its row has the reason
            outcome = _not_flown(error)
        row = {"case": case, "seed": int(seed), **self._named(values), **outcome}
        if (raised := self.runner.user_error) is not None:
            row[TRACEBACK] = "".join(traceback.format_exception(raised))
        return row if self._density is None else row | {LOG_WEIGHT: self._log_weight(seed)}

    def _log_weight(self, seed: int) -> float:
        """Return the logarithm of the weight of the case that was run last."""
        density = self._density
        assert density is not None
        normals = {
            name: block_normals(rows, rate_hz, density.block_s, density.blocks)
            for name, (rows, rate_hz) in self.runner.noise().items()
        }
        return density.log_weight(normals, self._design.normals(seed))

    def drawn(self, case: int) -> dict[str, float]:
        """Return the dispersions of ``case`` by their names."""
        return self._named(self._point(case)[0])

    def _named(self, values: Array) -> dict[str, float]:
        return dict(zip(self._design.names, map(float, values), strict=True))

    def _point(self, case: int) -> tuple[Array, int]:
        """Return the dispersed numbers of ``case``, and its seed."""
        design, campaign_seed = self._design, self._spec.seed
        if self._spec.sobol:
            unit, seed = sobol_point(campaign_seed, case, len(design.names))
            return design.values(case, unit=unit), seed
        mixed = self.mixed.get(case) if self._density is None else self._density.seed(campaign_seed, case)
        return design.values(case, mixed), case_seed(campaign_seed, case) if mixed is None else mixed


def _not_flown(error: Exception) -> dict[str, Any]:
    """Return the outcome of a case that cannot be run because of ``error``."""
    kind = "" if isinstance(error, BadInput) else f"{type(error).__name__}: "
    return failed_row(f"not flown: {kind}{' '.join(str(error).split())}")


def worker_count(workers: int) -> int:
    """Return ``workers``, for 0 one per core that this process may use."""
    return workers or len(os.sched_getaffinity(0))


def run_batch(spec: Spec, first: int, count: int) -> Rows:
    """Return the rows of the cases ``first`` .. ``first + count``, the same in any process and order."""
    campaign = replace(spec, mixed={})
    if getattr(_here, "spec", None) != campaign:
        _here.case, _here.spec = Case(spec), campaign
    _here.case.mixed = spec.mixed
    return [_here.case.row(case) for case in range(first, first + count)]
