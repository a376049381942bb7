"""``hil geometry``: plan, measure and fit the geometry of a bench, and check it for drift."""

from __future__ import annotations

import datetime
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import App, Parameter
from rich.console import Console

from hil.cli.options import Check, File, Flag, Group, Integer, Positive, Seed, Settings, bounded, refuse_wires_in_use
from hil.cli.output import deliver, file_path_problem, notices, say
from hil.cli.progress import ProgressBar
from hil.core.files import write_text
from hil.errors import BadInput

if TYPE_CHECKING:
    import numpy as np

    from hil.session.build import Job

app = App(name="geometry")
_PASSED, _FAILED = 0, 1


def _csv_problem(path: str) -> str:
    return file_path_problem(path) if path.endswith(".csv") else f"{path}: must end in .csv"


def _toml_problem(path: str) -> str:
    return file_path_problem(path) if path.endswith(".toml") else f"{path}: must end in .toml"


CsvFile = Annotated[str, Parameter(name=("--out", "-o")), Check(_csv_problem)]


@dataclass(frozen=True)
class SourceOptions:
    """Sources of observed poses."""

    vision: Flag = False
    """Also by the vision unit."""
    vision_alone: Flag = False
    """By the vision unit without a tracker."""
    tracker_mm: Positive = 0.1
    """Noise of a sample of the tracker, per axis."""
    tracker_deg: Positive = 0.01
    """The same for the attitude."""
    average_s: Positive = 1.0
    """Time of averaging at rest."""

    @property
    def names(self) -> list[str]:
        """Names of the sources."""
        return ["vmu"] if self.vision_alone else ["tracker", "vmu"] if self.vision else ["tracker"]

    def sigma(self) -> np.ndarray:
        """Return the noise of a sample of the tracker, (6,), m and rad."""
        import numpy as np

        return np.array([1e-3 * self.tracker_mm] * 3 + [np.radians(self.tracker_deg)] * 3)


_SOURCES = SourceOptions()


@dataclass(frozen=True)
class MovingOptions:
    """Motion of the axes."""

    yes: Flag = False
    """Confirm that the bench is clear (required for hardware rigs)."""
    speed: Positive = 1.0
    """Simulation speed relative to real time, on an emulated rig."""


_MOVING = MovingOptions()


@app.command(help="Plan the poses that make the parameters of the geometry observable.")
def plan(
    rig: str = "emulated",
    /,
    *,
    out: CsvFile,
    poses: Annotated[Integer, bounded(12, 500)] = 90,
    sources: Group[SourceOptions] = _SOURCES,
    seed: Seed = 0,
    scenario: str = "scheme-1",
    settings: Settings = (),
) -> int:
    """Choose poses within travel and guard volume, each with its reason; print the worst sigma that a fit will have.

    Parameters
    ----------
    rig
        mock, emulated, or the path of a rig file.
    out
        Plan to write, *.csv.
    poses
        Number of poses, of which a third is held out as check.
    seed
        Seed of the candidates.
    scenario
        Gives the cycle of the bench and the guard volume.
    """
    import numpy as np

    from hil.config.tables.machine import NAMES
    from hil.params import bench as bench_params
    from hil.parts.geometry.measure import clearance
    from hil.parts.geometry.model import MachineModel
    from hil.parts.geometry.plan import plan_poses, within_travel, write_plan
    from hil.parts.geometry.views import aimed_axes, shown_by, sigma_of_vision

    job = _job(rig, scenario, settings, seed, 1.0)
    bench = bench_params.bench(job.rig.value, job.scenario.value.step_s, job.scenario.value.bench)
    samples = max(1.0, sources.average_s / job.scenario.value.step_s)
    sigma = {"tracker": sources.sigma() / np.sqrt(samples), "vmu": sigma_of_vision(job, sources.average_s)}
    chosen = {name: sigma[name] for name in sources.names}
    proposals = {"tracker": partial(within_travel, bench), "vmu": partial(aimed_axes, job)}
    with notices().status("choosing poses"):
        planned = plan_poses(
            MachineModel(job.rig.value),
            bench,
            poses,
            chosen,
            partial(shown_by, job),
            [proposals[name] for name in chosen],
            clearance(job),
            np.random.default_rng(seed),
        )
    write_plan(planned, out)
    nothing = len(planned.not_observable) == len(NAMES)
    worst = "too few to determine anything" if nothing else f"predicted worst sigma {_pose_text(*planned.worst)}"
    say(f"{out}: {len(planned.axes)} poses, {worst}")
    _name_unknown(planned.not_observable)
    return _PASSED


@app.command(help="Move a rig through a plan under the usual interlocks, and write what is observed at rest.")
def measure(
    plan: str,
    /,
    *,
    rig: str = "emulated",
    out: CsvFile,
    sources: Group[SourceOptions] = _SOURCES,
    moving: Group[MovingOptions] = _MOVING,
    seed: Seed = 0,
    scenario: str = "scheme-1",
    settings: Settings = (),
) -> int:
    """Move through the poses of PLAN, average the observations at rest at each, and write one row per pose and source.

    The tracker is that of the rig's table [tracker]. A mock or emulated rig without one on a wire has a simulated one,
    which sees the machine as it is built.

    Parameters
    ----------
    plan
        Plan of `hil geometry plan`.
    rig
        mock, emulated, or the path of a rig file.
    out
        Observations to write, *.csv.
    seed
        Seed of the noise.
    scenario
        Gives the cycle of the bench and the guard volume.
    """
    refuse_wires_in_use(rig, settings)

    from hil.cli.warm_up import compile_kernels_with_notice
    from hil.parts.geometry.measure import measure as measured
    from hil.parts.geometry.observations import write_observations
    from hil.parts.geometry.plan import read_plan

    job, axes, console = _job(rig, scenario, settings, seed, moving.speed), read_plan(plan), notices()
    if job.rig.value.kind == "hardware" and not moving.yes:
        text = f"{job.rig.value.name} is hardware and its axes will move: clear the bench, then add --yes"
        raise BadInput.single("--yes", "", text)
    compile_kernels_with_notice(job, console)
    with ProgressBar(console, "opening the axes") as bar:
        announce = partial(say, console=console, style="dim")
        observations = measured(job, axes, sources.names, sources.sigma(), sources.average_s, bar.show, announce)
    write_observations(observations, out)
    say(f"{out}: {len(observations)} observations at {len(axes)} poses")
    return _PASSED


@app.command(help="Fit the geometry of a bench to observed poses.")
def fit(
    observations: str,
    /,
    *,
    rig: str = "emulated",
    out: Annotated[str, Parameter(name=("--out", "-o")), Check(_toml_problem)],
    largest_mm: Positive = 10.0,
    largest_deg: Positive = 1.0,
    date: str | None = None,
    json: File = None,
    settings: Settings = (),
) -> int:
    """Fit all observable parameters, with every third pose held out as check, and write a geometry file.

    The file is that of the rig's key bench.geometry_file. Parameters that the observations do not determine are named
    and left at zero.

    Parameters
    ----------
    observations
        Observed poses, *.csv.
    rig
        mock, emulated, or the path of a rig file.
    out
        Geometry file to write, *.toml.
    largest_mm
        Largest displacement that is an error of the bench, not of its rig file.
    largest_deg
        The same for rotations.
    date
        Date of the measurement, 2026-03-01; default: today.
    json
        File for the numbers, - for standard output.
    """
    import math

    from hil.config.load import load_rig
    from hil.config.tables.machine import NAMES
    from hil.parts.geometry.fit import Limits, geometry_file
    from hil.parts.geometry.fit import fit as fitted_to
    from hil.parts.geometry.model import MachineModel
    from hil.parts.geometry.observations import read_observations
    from hil.vmu.calibration.files import as_toml

    loaded, rows = load_rig(rig, settings), read_observations(observations)
    model = MachineModel(loaded.value)
    with notices().status("fitting"):
        fitted = fitted_to(model, rows)
    problem = fitted.problem(Limits(1e-3 * largest_mm, math.radians(largest_deg)))
    sigma = fitted.covariance.diagonal() ** 0.5
    content: dict[str, Any] = {
        "passed": not problem,
        "reason": problem,
        "poses": int(fitted.used.sum()),
        "rejected": int(fitted.rejected.sum()),
        "noise": fitted.noise,
        "held_out_mm": 1e3 * fitted.held_rms[0],
        "held_out_deg": math.degrees(fitted.held_rms[1]),
        "not_observed": fitted.not_observed,
        "parameters": {
            name: {"value": float(value), "sigma": float(each)}
            for name, value, each, known in zip(NAMES, fitted.vector, sigma, fitted.observed, strict=True)
            if known
        },
    }
    deliver(content, json, lambda: _show_fit(content))
    if problem:
        say(f"{observations}: refused: {problem}", notices(), "red")
        return _FAILED
    table = geometry_file(model, fitted, rows, _day(date)).model_dump(mode="json")
    write_text(as_toml(table, f"Geometry of {loaded.value.name}, measured: hil geometry fit."), out)
    say(f"{out}: for rig.bench.geometry_file", notices())
    return _PASSED


@app.command(help="Check a bench for drift against its geometry file, and append the result to a control chart.")
def check(
    observations: str,
    /,
    *,
    rig: str = "emulated",
    chart: Annotated[str | None, Check(_csv_problem)] = None,
    date: str | None = None,
    json: File = None,
    settings: Settings = (),
) -> int:
    """Compare observed poses with the geometry file of a rig: chi-square, and what a drift comes from.

    Parameters
    ----------
    observations
        Observed poses, *.csv: a dozen suffice.
    rig
        mock, emulated, or the path of a rig file, with the key bench.geometry_file.
    chart
        Control chart, *.csv, to which the result is appended.
    date
        Date of the check, 2026-03-01; default: today.
    json
        File for the numbers, - for standard output.
    """
    from hil.config.load import load_rig
    from hil.parts.geometry.check import append_to_chart
    from hil.parts.geometry.check import check as checked
    from hil.parts.geometry.model import MachineModel
    from hil.parts.geometry.observations import read_observations

    result = checked(MachineModel(load_rig(rig, settings).value), read_observations(observations))
    chart_text = "" if chart is None else append_to_chart(Path(chart), _day(date), result)
    content: dict[str, Any] = {
        "passed": result.passed,
        "poses": result.poses,
        "chi_square": result.chi_square,
        "dof": result.dof,
        "limit": result.limit,
        "verdict": result.verdict,
        "chart": chart_text,
    }
    deliver(content, json, lambda: _show_check(content))
    return _PASSED if result.passed else _FAILED


def _job(rig: str, scenario: str, settings: tuple[str, ...], seed: int, speed: float) -> Job:
    """Return the job of a measurement. Raises BadInput for a rig that cannot be moved."""
    from hil.config.load import load_rig, load_scenario
    from hil.session import build

    loaded = load_scenario(scenario, settings)
    job = build.Job(loaded, load_rig(rig, settings), seed, loaded.value.step_s, speed)
    build.check_rig(job)
    return job


def _day(date: str | None) -> str:
    today = datetime.datetime.now().astimezone().date()
    try:
        return (today if date is None else datetime.date.fromisoformat(date)).isoformat()
    except ValueError as error:
        raise BadInput.single("--date", "", f"{date}: must be a date like 2026-03-01") from error


def _pose_text(sigma_m: float, sigma_rad: float) -> str:
    import math

    return f"{1e3 * sigma_m:.3f} mm, {math.degrees(sigma_rad):.4f} deg"


def _name_unknown(names: tuple[str, ...] | list[str]) -> None:
    if names:
        say(f"not observable: {', '.join(names)}", Console())


def _show_fit(content: dict[str, Any]) -> None:
    say(
        f"{content['poses']} observations fitted, {content['rejected']} rejected, noise {content['noise']:.2f} times "
        f"the given one; held out: {content['held_out_mm']:.3f} mm, {content['held_out_deg']:.4f} deg rms"
    )
    _name_unknown(content["not_observed"])


def _show_check(content: dict[str, Any]) -> None:
    numbers = f"chi-square {content['chi_square']:.1f} of {content['dof']}, limit {content['limit']:.1f}"
    say(f"{content['verdict']}: {content['poses']} poses, {numbers}")
    if content["chart"]:
        say(content["chart"])
