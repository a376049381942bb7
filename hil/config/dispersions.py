"""Table ``[dispersions]`` of a scenario: random variation of its numbers from case to case of a campaign."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from hil.config.model import ConfigModel

Number = float | tuple[float, ...]


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


class Dispersions(ConfigModel):
    """Spreads under the names of the scenario's tables; each leaf is a ``Spread`` (docs/how-to/run-a-campaign.md).

    Keys under ``gnc`` change the parameters of the GNC; all others change the truth only.
    """

    sampling: Literal["random", "latin_hypercube", "sobol"] = "random"
    """Independent random numbers, blocks of Latin hypercubes, or a scrambled Sobol sequence (best with a power of two).
    """
    cases_per_hypercube: Annotated[int, Field(ge=2, le=100_000)] = 100
    """Cases per block of a Latin hypercube."""
    orbit: Table = Field(default_factory=dict)
    """Distributions of keys in `[orbit]`."""
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
    gnc: Table = Field(default_factory=dict)
    """Distributions of keys in `[gnc]`: of the parameters of the GNC itself, and of injected events."""


TABLES = ("orbit", "truth", "initial", "chaser", "imu", "vmu", "gnc")
