"""Explanation of a campaign: why its cases fail, from the first violated limits and the dispersed numbers.

Failing cases form a cluster for each limit that was broken first, in each phase. Of each: its fraction with interval,
a typical case, the nearest case that passes, the drivers (``hil.parts.campaigns.drivers``) with the threshold of the
first.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from hil.config.tables.units import UNITS, split
from hil.core.files import CONFIG_BYTES, MIB, check_regular, parse_json, read_text
from hil.errors import BadInput, one_line
from hil.gnc.decision_verdict import ACCUSED
from hil.maths.limits import finite_or_none
from hil.parts.campaigns.drivers import (
    DISTANCE_PRODUCT,
    RATIO,
    VALUE,
    Candidates,
    Drivers,
    Term,
    find_drivers,
    threshold,
)
from hil.parts.campaigns.outcome import COUNTS, FLAGS, MARGINS, NUMBERS, TEXTS
from hil.parts.campaigns.statistics import wilson
from hil.parts.campaigns.store import MANIFEST, TABLE, given_in, parquet, read_table
from hil.report.limits import LIMITS, bound, relative_margin, sentence, shown, unit_of, words_of

_START: Final = 1.0  # s, up to which a limit is broken by the start
_CLUSTERS: Final = 12  # whose drivers are looked for, the largest ones
_DIFFERENCES: Final = 5
_FIXED: Final = frozenset(("case", "seed", *FLAGS, *COUNTS, *TEXTS, *NUMBERS, *MARGINS))
_FAMILY: Final = {
    f"{what}_{axis}": f"{what}_across" for what in ("deviation", "velocity") for axis in ("y", "z")
}  # fmt: skip
"""Limits that are one in a cluster: both directions across the docking axis."""
Column = Callable[[str], Any]


class Cases:
    """Cases of a finished campaign in ``folder``. Raises BadInput if it holds none, or one of an earlier version."""

    def __init__(self, folder: Path, option: str = "hil explain") -> None:
        pa, _ = parquet()
        path = folder / TABLE
        self.folder = folder
        if not (folder / MANIFEST).is_file():
            raise BadInput.single(option, "", f"{folder}: holds no campaign")
        if not path.is_file():
            raise BadInput.single(option, "", f"{folder}: its campaign is not finished: run it again to the end")
        try:
            self.identity: dict[str, Any] = parse_json(read_text(folder / MANIFEST, CONFIG_BYTES))
            check_regular(path, 1 << 40)
            self.table = read_table(path)
        except (BadInput, OSError, ValueError, pa.ArrowException) as error:
            raise BadInput.single(option, "", f"{path}: cannot be read: {one_line(str(error), 200)}") from error
        if "first_violated" not in self.table.column_names:
            text = f"{path}: has no column first_violated: it is of an earlier version, run the campaign again"
            raise BadInput.single(option, "", text)

    @property
    def summary(self) -> dict[str, Any]:
        """Content of ``summary.json``; empty without one."""
        path = self.folder / "summary.json"
        summary: dict[str, Any] = parse_json(read_text(path, 64 * MIB)) if path.is_file() else {}
        return summary

    def column(self, name: str) -> Any:
        """Return a column as a numpy array, (n,); missing numbers are nan."""
        return self.table.column(name).to_numpy()

    @property
    def names(self) -> list[str]:
        """Names of the dispersed numbers."""
        return dispersed_names(self.table.column_names)


def dispersed_names(columns: list[str]) -> list[str]:
    """Return the ``columns`` of a campaign that are dispersed numbers."""
    return [name for name in columns if name not in _FIXED and not name.startswith("weight_") and "." in name]


def explain(column: Column, names: list[str], seed: int = 0) -> dict[str, Any]:
    """Return why cases fail, by the keys of ``hil explain --json``. names: of the dispersed numbers.

    column: of a campaign's cases by its name.
    """
    campaign = _Campaign(column, names)
    failed = ~campaign.accepted
    n = len(failed)
    drivers = campaign.drivers(failed & ~campaign.by_start, seed)
    causes = [campaign.cause(limit, phase, members, seed) for limit, phase, members in campaign.clusters()]
    return {
        "runs": n,
        "accepted": wilson(int(campaign.accepted.sum()), n),
        "failed": int(failed.sum()),
        "failed_by_start": int((failed & campaign.by_start).sum()),
        "causes": causes,
        "drivers": [{"name": name, "importance": value} for name, value in drivers.importance.items()],
        "terms": [term_text(term, names) for term in drivers.terms],
        "score": drivers.score,
        "nothing_found": drivers.nothing_found and not any(cause["driver"] for cause in causes),
        "false_alarms": [
            {"bit": name, "alarms": int(total), "per_1000": 1000.0 * float(total) / n}
            for name in ACCUSED
            for total in [np.nansum(column(f"false_alarm_{name}"))]
        ],
    }


class _Campaign:
    def __init__(self, column: Column, names: list[str], ranked: bool = True) -> None:
        self.names = names
        self.case = np.asarray(column("case"), dtype=int)
        self.accepted = np.asarray(column("accepted"), dtype=bool)
        self.limit = np.asarray(column("first_violated"), dtype=object).astype(str)
        self.phase = np.asarray(column("first_violated_phase"), dtype=object).astype(str)
        self.at_s, self.value, self.allowed = (
            np.asarray(column(f"first_violated_{name}"), dtype=float) for name in ("s", "value", "limit")
        )
        self.term = np.asarray(column("first_violated_term"), dtype=object).astype(str)
        stop = np.asarray(column("stop"), dtype=object).astype(str)
        self.limit[~self.accepted & (self.limit == "")] = "not_flown"
        self.limit[np.char.startswith(stop.astype(str), "not flown")] = "not_flown"
        self.cycles = np.asarray(column("cycles"), dtype=int)
        self.by_start = ~self.accepted & (
            (self.limit == "start_corridor") | (self.cycles == 0) | (self.at_s <= _START)
        )  # fmt: skip
        self.values = np.column_stack([np.asarray(column(name), dtype=float) for name in names] or [self.at_s * 0.0])
        self.names = names or ["none"]
        complete = np.isfinite(self.values).all(axis=1)
        self.complete = complete
        self.values[~complete] = 0.0
        self.spread = np.where(self.values.std(axis=0) > 0.0, self.values.std(axis=0), np.inf)
        self.candidates = Candidates(self.values if ranked else self.values[:, :0])

    def clusters(self) -> list[tuple[str, str, np.ndarray]]:
        """Return limit, phase and members of each cluster, the largest first."""
        limits = np.array([_FAMILY.get(name, name) for name in self.limit])
        keys = np.char.add(np.char.add(limits.astype(str), "\n"), self.phase.astype(str))
        clusters = []
        for key in np.unique(keys[~self.accepted]):
            limit, _, phase = str(key).partition("\n")
            clusters.append((limit, phase, (keys == key) & ~self.accepted))
        return sorted(clusters, key=lambda each: (-int(each[2].sum()), each[0], each[1]))[:_CLUSTERS]

    def drivers(self, members: np.ndarray, seed: int) -> Drivers:
        """Return the drivers of ``members`` (n,) against the cases that are accepted."""
        used = (members | self.accepted) & self.complete
        return find_drivers(self.candidates, self.names, members, used, seed)

    def cause(self, limit: str, phase: str, members: np.ndarray, seed: int) -> dict[str, Any]:
        """Return a cluster by the keys of the JSON."""
        size, failed = int(members.sum()), int((~self.accepted).sum())
        share, drivers = wilson(size, failed), self.drivers(members, seed)
        typical = self._typical(members)
        cause: dict[str, Any] = {
            "limit": limit,
            "phase": phase,
            "cases": size,
            "share": share["rate"],
            "low": share["low"],
            "high": share["high"],
            "by_start": bool(np.mean(self.by_start[members]) > 0.5),
            "case": int(self.case[typical]),
            "value": finite_or_none(self.value[typical]),
            "allowed": finite_or_none(self.allowed[typical]),
            "unit": unit_of(limit),
            "term": self._common(self.term[members]),
            "driver": None,
            "drivers": [{"name": name, "importance": value} for name, value in drivers.importance.items()],
            "score": drivers.score,
            "threshold": None,
        }
        if drivers.terms:
            term, used = drivers.terms[0], (members | self.accepted) & self.complete
            cause["driver"] = term_text(term, self.names)
            cause["threshold"] = threshold(term, self.values[used], members[used])
            cause["threshold"] |= {"unit": _unit_of_term(term, self.names), "kind": _measured(term)}
        cause["nearest"] = self.nearest(typical)
        return cause | {"text": cause_text(cause, failed)}

    def _typical(self, members: np.ndarray) -> int:
        """Return the place of the member whose value over its limit is the median."""
        at = np.flatnonzero(members)
        with np.errstate(all="ignore"):
            ratio = np.nan_to_num(self.value[at] / self.allowed[at], nan=0.0, posinf=1e9, neginf=-1e9)
        return int(at[np.argsort(ratio, kind="stable")[(len(at) - 1) // 2]])

    @staticmethod
    def _common(texts: np.ndarray) -> str:
        values, counts = np.unique(texts.astype(str), return_counts=True)
        return str(values[np.argmax(counts)]) if len(values) else ""

    def nearest(self, row: int) -> dict[str, Any] | None:
        """Return the accepted case nearest to that at ``row``, in standard deviations, and how they differ."""
        passing = np.flatnonzero(self.accepted & self.complete)
        if not len(passing) or not self.complete[row]:
            return None
        apart = (self.values[passing] - self.values[row]) / self.spread
        best = int(np.argmin((apart**2).sum(axis=1)))
        order = np.argsort(-np.abs(apart[best]), kind="stable")[:_DIFFERENCES]
        return {
            "case": int(self.case[passing[best]]),
            "differences": [
                {
                    "name": self.names[j],
                    "value": float(self.values[passing[best], j]),
                    "here": float(self.values[row, j]),
                    "sigmas": float(apart[best, j]),
                }
                for j in order
                if apart[best, j] != 0.0
            ],
        }


def term_text(term: Term, names: list[str]) -> str:
    """Return a term as text: its names, with the operation."""
    first = names[term.numbers[0]]
    if len(term.numbers) == 2:
        second = names[term.numbers[1]]
        return f"{first} / {second}" if term.kind == RATIO else f"{first} x {second}"
    return first


def _measured(term: Term) -> str:
    """Return what of a term is compared: its value, its distance from a centre, or the product of both."""
    if len(term.numbers) == 1:
        centre = term.centres[0]
        return "value" if term.kind == VALUE else ("size" if centre == 0.0 else f"distance from {centre:.4g}")
    about = "" if term.centres == (0.0, 0.0) else f" about {term.centres[0]:.4g} and {term.centres[1]:.4g}"
    return f"{'size of the product' if term.kind == DISTANCE_PRODUCT else term.kind}{about}"


def _unit_of_term(term: Term, names: list[str]) -> str:
    key = names[term.numbers[0]].partition("[")[0]
    unit = split(key)[1] if len(term.numbers) == 1 else ""
    return UNITS[unit].text if unit else ""


def cause_text(cause: dict[str, Any], failed: int) -> str:
    """Return a cluster as a sentence. failed: cases that fail."""
    text = f"{cause['cases']} of {failed} failures: {words_of(cause['limit'])}"
    if cause["value"] is not None and cause["allowed"] is not None:
        here, allowed = (shown(cause[name], cause["unit"]) for name in ("value", "allowed"))
        verb = "exceeds its limit" if bound(cause["limit"]) == "allowed" else "is too small"
        text += f" {verb} (case {cause['case']}: {here}, {bound(cause['limit'])} {allowed})"
    else:
        text += f" (case {cause['case']})"
    if cause["phase"]:
        text += f", in phase {cause['phase']}"
    if cause["term"]:
        text += f", most of it {cause['term']}"
    if cause["by_start"]:
        text += "; broken by the start itself"
    return f"{text}; {driver_text(cause)}"


def driver_text(cause: dict[str, Any]) -> str:
    """Return the driver of a cluster with its threshold."""
    cut = cause["threshold"]
    if cut is None:
        return "no dispersed number found that decides it"
    what = cause["driver"]
    where = f"{cut['side']} {shown(cut['value'], cut['unit'])}"
    if cut["kind"] != "value":
        where = f"{cut['kind']} {where}"
    passes = f"{'none' if not cut['passes'] else cut['passes']} of {cut['cases']} pass"
    return f"driven by {what}: {where} {passes}, otherwise {cut['other_passes']} of {cut['other_cases']}"


def command_of(identity: Mapping[str, Any], folder: str, case: int) -> str:
    """Return the command that flies ``case`` of a campaign. identity: content of its MANIFEST."""
    given = given_in(identity)
    if not given:
        return f"hil run {identity['scenario']} --campaign {folder} --case {case}"
    settings = [text for setting in given["settings"] for text in ("--set", setting)]
    options = ["--rig", given["rig"], *settings, "--campaign", folder, "--case", str(case)]
    return shlex.join(["hil", "run", given["scenario"], *options])


def case_of(table: Any, case: int, identity: Mapping[str, Any], folder: str = "DIR") -> dict[str, Any]:
    """Return why ``case`` of the pyarrow ``table`` fails: its cause, margins by size, alarms, the nearest that passes.

    identity, folder: of the campaign, for the command that flies the case. Raises BadInput for a case without a row.
    """
    at = np.flatnonzero(table.column("case").to_numpy() == case)
    if not len(at):
        raise BadInput.single("--case", "", f"{case}: not in the campaign, which has 0 to {len(table) - 1}")
    index = int(at[0])
    row: dict[str, Any] = table.slice(index, 1).to_pylist()[0]
    campaign = _Campaign(lambda name: table.column(name).to_numpy(), dispersed_names(table.column_names), False)
    margins = [
        {
            "limit": name,
            "margin": row[f"margin_{name}"],
            "at_s": row[f"margin_{name}_s"],
            "value": row[f"margin_{name}_value"],
            "allowed": row[f"margin_{name}_limit"],
            "term": row[f"margin_{name}_term"] or None,
            "unit": unit_of(name),
        }
        for name in LIMITS
        if row[f"margin_{name}_limit"] is not None
    ]
    margins.sort(key=relative_margin)
    return {
        "case": case,
        "accepted": bool(row["accepted"]),
        "first_violated": {name: row[f"first_violated{name}"] for name in ("", "_s", "_value", "_limit", "_term",
                                                                            "_phase")},
        "text": sentence(row) or "accepted: no limit was broken",
        "alarms_before": row["alarms_before"],
        "stop": row["stop"],
        "limits": margins,
        "nearest": None if row["accepted"] else campaign.nearest(index),
        "command": command_of(identity, folder, case),
    }  # fmt: skip
