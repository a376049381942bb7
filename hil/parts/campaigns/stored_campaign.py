"""Folder of a campaign as ``hil run --campaign`` reads it: identity, and the seeds of its cases."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hil.core.files import CONFIG_BYTES, parse_json, read_text
from hil.errors import BadInput, one_line
from hil.maths.random_streams import MixedSeed
from hil.parts.campaigns.importance_campaign import DENSITY, read_density
from hil.parts.campaigns.rare_campaign import PARENT, SCALE, stored_seed
from hil.parts.campaigns.store import MANIFEST, PARTS, TABLE, parquet, read_table

_OPTION = "--campaign"


class StoredCampaign:
    """The campaign in ``folder``, finished or not. Raises BadInput if it holds none."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        path = folder / MANIFEST
        if not path.is_file():
            raise BadInput.single(_OPTION, "", f"{folder}: holds no campaign")
        try:
            self.identity: Any = parse_json(read_text(path, CONFIG_BYTES))
            identity = self.identity
            self.scenario, self.digest = str(identity["scenario"]), str(identity["digest"])
            self.scenario_digest = str(identity.get("scenario_digest", ""))
            self.seed, self.duration_s = int(identity["seed"]), float(identity["duration_s"])
            self.is_rare, self.is_sobol = "rare" in identity, "sobol" in identity
            self.is_importance = "importance" in identity
        except (BadInput, ValueError, TypeError, KeyError) as error:
            raise BadInput.single(_OPTION, "", f"{path}: cannot be read: {one_line(str(error), 200)}") from error

    @property
    def is_sample(self) -> bool:
        """Whether its cases are a sample of the scenario: not moved, weighted or paired by a study."""
        return not (self.is_rare or self.is_sobol or self.is_importance)

    def mixed_seed(self, case: int) -> MixedSeed | None:
        """Return the seed of ``case`` of a rare-event campaign, None for a case of another one. Raises BadInput."""
        if self.is_importance:
            return read_density(self._folder / DENSITY).seed(self.seed, case)
        if not self.is_rare:
            return None
        points = self._points()
        if case not in points:
            last = f"0 to {max(points)}" if points else "none"
            raise BadInput.single("--case", "", f"{case}: not in {self._folder}, which has {last}")
        try:
            return stored_seed(case, self.seed, points.__getitem__)
        except (KeyError, ValueError) as error:
            raise BadInput.single(_OPTION, "", f"{self._folder}: its cases are damaged: {error}") from error

    def _points(self) -> dict[int, tuple[int, float]]:
        """Return parent and scale of each case."""
        pa, _ = parquet()
        table = self._folder / TABLE
        files = [table] if table.is_file() else sorted((self._folder / PARTS).glob("*.parquet"))
        points: dict[int, tuple[int, float]] = {}
        try:
            for file in files:
                read = read_table(file, ["case", PARENT, SCALE])
                cases, parents, scales = (column.to_pylist() for column in read.columns)
                points |= {c: (int(p), float(s)) for c, p, s in zip(cases, parents, scales, strict=True)}
        except (OSError, ValueError, TypeError, LookupError, pa.ArrowException) as error:
            raise BadInput.single(_OPTION, "", f"{self._folder}: {one_line(str(error), 200)}") from error
        return points
