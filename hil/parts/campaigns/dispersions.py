"""Dispersions: samples the dispersed scenario of a case.

A case depends on its number and the campaign's seed only, not on the number of cases: ``hil run --case K`` and a longer
campaign have the same one. Latin hypercubes therefore come in blocks of
``cases_per_hypercube``; Sobol's points are scrambled by the seed and numbered consecutively.
"""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import scipy  # its parts are imported when they are used

from hil.config.load import Loaded, check_table
from hil.config.scenario import Scenario
from hil.config.tables.dispersions import TABLES, FaultDispersion, Number, Spread
from hil.config.tables.faults import AXES
from hil.core.messages import Array
from hil.errors import BadInput, Problem, did_you_mean
from hil.maths import linear
from hil.maths.normals import Generator
from hil.maths.random_streams import MixedSeed, generator_of, noise_source
from hil.maths.special import normal_probabilities, normal_probability, normal_quantile

_DESIGN, _CASE, _FAULT = 0, 1, 2
_SMALLEST = 1.0 / 2**40  # least distance of a unit point from 0 and 1, where the normal's inverse is infinite


def case_seed(campaign_seed: int, case: int) -> int:
    """Return the seed of all sensor noise and thruster errors of a case: as for ``hil run --seed``."""
    sequence = np.random.SeedSequence(campaign_seed, spawn_key=(_CASE, case))
    return int(sequence.generate_state(1, np.uint64)[0] >> np.uint64(1))


@dataclass(frozen=True)
class DispersedComponent:
    """One dispersed number: component ``index`` of the key at ``path``, None for the whole key."""

    path: tuple[str, ...]
    index: int | None
    kind: str
    centre: float
    sigma: float
    low: float
    high: float
    factor: bool  # the sample multiplies a whole matrix

    @property
    def name(self) -> str:
        key = ".".join(self.path)
        return key if self.index is None else f"{key}[{self.index}]"

    def value(self, unit: float) -> float:
        """Return the number at ``unit``, 0..1, of the distribution."""
        if self.kind == "uniform":
            return self.low + unit * (self.high - self.low)
        if self.sigma == 0.0:
            return min(self.high, max(self.low, self.centre))
        below, above = (normal_probability((edge - self.centre) / self.sigma) for edge in (self.low, self.high))
        drawn = self.centre + self.sigma * normal_quantile(below + unit * (above - below))
        return min(self.high, max(self.low, drawn))


class Design:
    """The dispersions of a scenario, checked; raises BadInput with one problem per error."""

    def __init__(self, scenario: Loaded[Scenario], seed: int) -> None:
        self._nominal = scenario.value
        self._table = scenario.value.model_dump(exclude={"dispersions"})
        self._text = json.dumps(self._table)
        self._settings = scenario.value.dispersions
        self._seed = seed
        problems: list[Problem] = []
        self.components: list[DispersedComponent] = []
        for name in TABLES:
            for path, raw in _leaves(getattr(self._settings, name), self._table[name], (name,), scenario, problems):
                self._add(path, raw, scenario, problems)
        if problems:
            raise BadInput(problems)
        of_orbit = {component.path[1] for component in self.components if component.path[0] == "orbit"}
        # where the target is on a circle matters to inertial sensors alone
        uses_place = self._nominal.gnc_orbit.eccentricity != 0.0 or bool(self._nominal.sensors)
        self._orbit_is_dispersed = bool(of_orbit & {"altitude_m", "eccentricity"}) or (uses_place and bool(of_orbit))
        self.touches_gnc = self._orbit_is_dispersed or any(component.path[0] == "gnc" for component in self.components)

    def _add(self, path: tuple[str, ...], raw: Any, scenario: Loaded[Scenario], problems: list[Problem]) -> None:
        key = f"dispersions.{'.'.join(path)}"
        set_by = [origin for name, origin in scenario.origin.items() if name.startswith(f"{key}.")]
        where = "--set" if "--set" in set_by else scenario.where(key)
        if not isinstance(raw, dict):
            problems.append(Problem(where, key, f'{raw!r}: must be a table, {{ kind = "normal", sigma = 0.1 }}'))
            return
        try:
            spread = check_table(raw, Spread, where, prefix=f"{key}.").value
            self.components += _components(path, _at(self._table, path), spread)
        except BadInput as error:
            problems += [Problem(fault.source, fault.key or key, fault.message) for fault in error.problems]
        except ValueError as error:
            problems.append(Problem(where, key, str(error)))

    @property
    def draws_faults(self) -> bool:
        """Whether cases have drawn faults."""
        return bool(self._settings.faults.draw)

    @property
    def names(self) -> list[str]:
        """Names of the dispersed numbers, in their order."""
        return [component.name for component in self.components]

    def values(self, case: int, mixed: MixedSeed | None = None, unit: Array | None = None) -> Array:
        """Return the numbers of ``case``, in the order of ``names``.

        mixed: the seed of a case of a rare-event campaign, whose normals take the place of the sampling plan. unit: the
        case's point in the unit cube, likewise.
        """
        if unit is not None:
            unit = self._inside(unit)
        else:
            unit = self._unit(case) if mixed is None else self._inside(normal_probabilities(self.normals(mixed)))
        return np.array([component.value(float(u)) for component, u in zip(self.components, unit, strict=True)])

    def normals(self, seed: int) -> Array:
        """Return the standard normals of the dispersed numbers in a rare-event campaign, in the order of ``names``."""
        normals: Array = noise_source(seed, "dispersions").standard_normal((len(self.components),))
        return normals

    def fault(self, case: int) -> dict[str, Any] | None:
        """Return the fault of ``case``, a table of ``[[faults]]``; None if it has none."""
        if not self._settings.faults.draw:
            return None
        sequence = np.random.SeedSequence(self._seed, spawn_key=(_FAULT, case))
        return drawn_fault(self._settings.faults, len(self._nominal.chaser.thrusters.position_m), sequence)

    def apply(self, values: Array, fault: dict[str, Any] | None = None) -> tuple[Scenario, Scenario]:
        """Return the scenarios of truth and GNC; raise BadInput if one is invalid.

        The GNC has the nominal numbers, the dispersed ones of its own table, and the target's orbit.
        fault: added to the scenario's faults.
        """
        truth, gnc = (json.loads(self._text) for _ in range(2))
        if fault is not None:
            truth["faults"] = [*truth["faults"], fault]
        for component, value in zip(self.components, values, strict=True):
            _put(truth, component, float(value))
            if component.path[0] == "gnc":
                _put(gnc, component, float(value))
        if self._orbit_is_dispersed:
            gnc["orbit"] = truth["orbit"]
        dispersed = (
            check_table(truth, Scenario, "dispersed").value if self.components or fault is not None else self._nominal
        )
        return dispersed, check_table(gnc, Scenario, "dispersed").value if self.touches_gnc else self._nominal

    def _unit(self, case: int) -> Array:
        """Return the point of ``case`` in the unit cube, (n,), without its faces."""
        n, settings = len(self.components), self._settings
        if n == 0:
            return np.empty(0)
        if settings.sampling == "latin_hypercube":
            block, row = divmod(case, settings.cases_per_hypercube)
            unit = _hypercube(self._seed, block, settings.cases_per_hypercube, n)[row]
        elif settings.sampling == "sobol":
            unit = _sobol_point(self._seed, case, n)
        else:
            unit = generator_of(self._seed, (_DESIGN, case)).random(n)
        return self._inside(unit)

    @staticmethod
    def _inside(unit: Array) -> Array:
        inside: Array = np.clip(unit, _SMALLEST, 1.0 - _SMALLEST)
        return inside


def drawn_fault(settings: FaultDispersion, thrusters: int, seed: np.random.SeedSequence) -> dict[str, Any] | None:
    """Return a table of ``[[faults]]``, drawn from the kinds of ``settings``; None for no fault."""
    generator = Generator(np.random.PCG64(seed))
    if generator.random() >= settings.probability:
        return None
    weights = np.array([draw.weight for draw in settings.draw])
    draw = settings.draw[int(generator.choice(len(weights), p=weights / weights.sum()))]
    devices = {"thruster": [f"thruster.{i + 1}" for i in range(thrusters)], "axis": list(AXES)}
    device = str(generator.choice(devices.get(draw.device, [draw.device])))
    table: dict[str, Any] = {"device": device, "kind": draw.kind, "at_s": _uniform(generator, draw.at_s)}
    if draw.value is not None:
        size = _uniform(generator, draw.value)
        if draw.term is not None and draw.term.values == 3:
            direction = generator.standard_normal(3)
            table["value"] = [float(part) for part in size * direction / linear.length(direction)]
        else:
            table["value"] = size
    if draw.lasting_s is not None:
        table["until_s"] = table["at_s"] + _uniform(generator, draw.lasting_s)
    return table | {name: value for name in ("size_m", "sensor") if (value := getattr(draw, name)) is not None}


def _uniform(generator: np.random.Generator, interval: tuple[float, float]) -> float:
    low, high = interval
    return low + (high - low) * float(generator.random())


@lru_cache(maxsize=4)
def _hypercube(seed: int, block: int, cases: int, n: int) -> Array:
    generator = generator_of(seed, (_DESIGN, block))
    points: Array = scipy.stats.qmc.LatinHypercube(n, rng=generator).random(cases)
    return points


_SOBOL_BLOCK = 64


@lru_cache(maxsize=4)
def _sobol_block(seed: int, block: int, n: int) -> Array:
    generator = generator_of(seed, (_DESIGN,))
    engine = scipy.stats.qmc.Sobol(n, scramble=True, rng=generator)
    if block:
        engine.fast_forward(block * _SOBOL_BLOCK)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # a section of the sequence need not be balanced
        points: Array = engine.random(_SOBOL_BLOCK)
    return points


def _sobol_point(seed: int, case: int, n: int) -> Array:
    block, row = divmod(case, _SOBOL_BLOCK)
    point: Array = _sobol_block(seed, block, n)[row]
    return point


def _at(table: Any, path: tuple[str, ...]) -> Any:
    for key in path:
        table = table[key]
    return table


def _leaves(
    given: dict[str, Any], table: Any, path: tuple[str, ...], scenario: Loaded[Scenario], problems: list[Problem]
) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield path and distribution of each key under ``given``; add a problem for each unknown key."""
    for key, inner in given.items():
        here = (*path, key)
        if not isinstance(table, dict) or key not in table:
            keys = sorted(table) if isinstance(table, dict) else []
            hint, name = did_you_mean(key, keys), f"dispersions.{'.'.join(here)}"
            problems.append(scenario.problem(name, f"unknown key: {hint}known here: {', '.join(keys) or 'none'}"))
        elif isinstance(table[key], dict) and isinstance(inner, dict):
            yield from _leaves(inner, table[key], here, scenario, problems)
        else:
            yield here, inner


def _components(path: tuple[str, ...], nominal: Any, spread: Spread) -> list[DispersedComponent]:
    """Return the dispersed components of one key; raise ValueError if the distribution does not suit its value."""
    matrix = isinstance(nominal, (tuple, list)) and any(isinstance(row, (tuple, list)) for row in nominal)
    if matrix:
        if not spread.relative:
            raise ValueError("is a matrix: needs relative = true, one factor for all of it")
        return [_component(path, None, 1.0, spread, 0, 1, factor=True)]
    if isinstance(nominal, (tuple, list)):
        return [_component(path, i, value, spread, i, len(nominal)) for i, value in enumerate(nominal)]
    return [_component(path, None, nominal, spread, 0, 1)]


def _component(
    path: tuple[str, ...], index: int | None, nominal: Any, spread: Spread, i: int, n: int, factor: bool = False
) -> DispersedComponent:
    is_number = isinstance(nominal, float)
    if not is_number and nominal is not None:
        raise ValueError(f"{nominal!r}: only keys with decimal numbers can be spread")
    if nominal is None and (spread.relative or (spread.kind == "normal" and spread.mean is None)):
        raise ValueError("has no value in this scenario: give mean and sigma, or low and high, without relative")
    scale = nominal if spread.relative else 1.0
    centre = _pick(spread.mean, i, n)
    ends = sorted(
        (
            -math.inf if spread.low is None else scale * _pick(spread.low, i, n, 0.0),
            math.inf if spread.high is None else scale * _pick(spread.high, i, n, 0.0),
        )
    )
    return DispersedComponent(
        path,
        index,
        spread.kind,
        (nominal if nominal is not None else 0.0) if centre is None else scale * centre,
        abs(scale) * _pick(spread.sigma, i, n, 0.0),
        ends[0],
        ends[1],
        factor,
    )


def _pick(value: Number | None, i: int, n: int, otherwise: Any = None) -> Any:
    if value is None:
        return otherwise
    if not isinstance(value, tuple):
        return value
    if len(value) != n:
        raise ValueError(f"{list(value)}: must be one number or {n}")
    return value[i]


def _put(table: Any, component: DispersedComponent, value: float) -> None:
    *parents, last = component.path
    parent = _at(table, tuple(parents))
    if component.factor:
        parent[last] = [[value * entry for entry in row] for row in parent[last]]
    elif component.index is None:
        parent[last] = value
    else:
        parent[last][component.index] = value
