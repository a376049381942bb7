"""Table ``[dispersions]`` of a scenario: random variation of its numbers from case to case of a campaign."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from hil.config.tables.faults import AXES, TERMS, ErrorTerm, Sensor
from hil.config.tables.model import ConfigModel, Name, Positive

Number = float | tuple[float, ...]
Range = tuple[float, float]


class Spread(ConfigModel):
    """Distribution of one key. A list has one number per component of the key, a single number holds for all.

    normal: about ``mean``, by default the scenario's value, with ``sigma``, truncated below ``low`` and above ``high``
    if given. uniform: from ``low`` to ``high``. With ``relative`` all four are factors of the scenario's value.
    """

    kind: Literal["normal", "uniform"]
    """Normal, truncated at `low` and `high` if given, or uniform from `low` to `high`."""
    sigma: Number | None = None
    """Standard deviation of a normal distribution, not negative."""
    mean: Number | None = None
    """Mean of a normal distribution; unless set, the scenario's value."""
    low: Number | None = None
    """Lower bound."""
    high: Number | None = None
    """Upper bound."""
    relative: bool = False
    """Whether the other numbers are factors of the scenario's value."""

    @model_validator(mode="after")
    def _numbers_suit_the_kind(self) -> Self:
        needed, foreign = (("sigma",), ()) if self.kind == "normal" else (("low", "high"), ("sigma", "mean"))
        for name in needed:
            if getattr(self, name) is None:
                raise ValueError(f'kind = "{self.kind}" needs {name}')
        for name in foreign:
            if getattr(self, name) is not None:
                raise ValueError(f'{name} does not go with kind = "{self.kind}", which takes: {", ".join(needed)}')
        for value in _each(self.sigma):
            if value < 0.0:
                raise ValueError(f"sigma = {value:g}: must not be negative")
        lows, highs = _each(self.low), _each(self.high)
        for low, high in zip(lows * max(1, len(highs)), highs * max(1, len(lows)), strict=False):
            if not low < high:
                raise ValueError(f"low = {low:g}, high = {high:g}: low must be below high")
        return self


def _each(value: Number | None) -> tuple[float, ...]:
    if value is None:
        return ()
    return value if isinstance(value, tuple) else (value,)


Table = dict[str, Any]


class FaultDraw(ConfigModel):
    """A kind of fault that a case may have, and the ranges of its size, onset and duration, all uniform."""

    device: str
    """As in `[[faults]]`; `thruster` or `axis`: any of them, with equal probability."""
    kind: str
    """Kind of fault: see [Faults](faults.md)."""
    weight: Positive = 1.0
    """Its probability relative to the other kinds."""
    value: Range | None = None
    """Range of the number, or of the magnitude of a vector of random direction."""
    at_s: Range
    """Range of the onset."""
    lasting_s: Range | None = None
    """Range of the duration; unless set, to the end of the run."""
    size_m: Positive | None = None
    """As in `[[faults]]`."""
    sensor: Sensor | None = None
    """As in `[[faults]]`."""

    @model_validator(mode="after")
    def _is_in_the_table(self) -> Self:
        term = self.term
        if term is None:
            raise ValueError(f'device = "{self.device}", kind = "{self.kind}": not in the table of faults')
        if term.values == 2:
            raise ValueError(f'kind = "{self.kind}": has two numbers and cannot be drawn')
        if (self.value is None) != (term.values == 0 or term.default is not None):
            raise ValueError(f'kind = "{self.kind}" {"needs value" if self.value is None else "has no value"}')
        if self.at_s[0] < 0.0:
            raise ValueError(f"at_s = {list(self.at_s)}: must not be negative")
        for name in ("value", "at_s", "lasting_s"):
            given = getattr(self, name)
            if given is not None and not given[0] <= given[1]:
                raise ValueError(f"{name} = {list(given)}: the first number must not exceed the second")
        return self

    @property
    def term(self) -> ErrorTerm | None:
        """Entry of the table of faults, None if there is none."""
        family = "axis" if self.device in AXES else self.device.partition(".")[0]
        return TERMS.get(family, {}).get(self.kind)


class FaultDispersion(ConfigModel):
    """Faults of the cases of a campaign: a case has at most one, of a kind that is drawn by weight."""

    probability: Annotated[float, Field(ge=0.0, le=1.0)] = 1.0
    """Of a case to have a fault."""
    draw: tuple[FaultDraw, ...] = ()
    """Kinds of faults."""


class Dispersions(ConfigModel):
    """Spreads under the names of the scenario's tables; each leaf is a ``Spread`` (docs/how-to/run-a-campaign.md).

    Keys under ``gnc`` change the parameters of the GNC, those under ``orbit`` the target's orbit for truth and GNC; all
    others change the truth only.
    """

    name: Name = ""
    """Name of the set, in results."""
    sampling: Literal["random", "latin_hypercube", "sobol"] = "random"
    """Independent random numbers, blocks of Latin hypercubes, or a scrambled Sobol sequence (best with a power of two).
    """
    cases_per_hypercube: Annotated[int, Field(ge=2, le=100_000)] = 100
    """Cases per block of a Latin hypercube."""
    orbit: Table = Field(default_factory=dict)
    """Distributions of keys in `[orbit]`."""
    target: Table = Field(default_factory=dict)
    """Distributions of keys in `[target]`: the GNC keeps the nominal ones."""
    truth: Table = Field(default_factory=dict)
    """Distributions of keys in `[truth]`."""
    initial: Table = Field(default_factory=dict)
    """Distributions of keys in `[initial]`."""
    chaser: Table = Field(default_factory=dict)
    """Distributions of keys in `[chaser]`."""
    imu: Table = Field(default_factory=dict)
    """Distributions of keys in `[imu]`."""
    vmu: Table = Field(default_factory=dict)
    """Distributions of keys in `[vmu]`."""
    bench: Table = Field(default_factory=dict)
    """Distributions of keys in `[bench.errors]`: how the bench is built wrong."""
    sensors: Table = Field(default_factory=dict)
    """Distributions of keys of `[[sensors]]`, by their names: the filters keep the nominal ones."""
    faults: FaultDispersion = FaultDispersion.model_construct()
    gnc: Table = Field(default_factory=dict)
    """Distributions of keys in `[gnc]`: of the parameters of the GNC itself, and of injected events."""


TABLES = ("orbit", "target", "truth", "initial", "chaser", "imu", "vmu", "bench", "sensors", "gnc")
