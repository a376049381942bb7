"""Campaigns whose failures have a known cause, or none: short runs of scheme 1 that begin at the ready point."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from hil.config.load import load_rig, load_scenario
from hil.parts.campaigns.campaign import CampaignJob
from hil.parts.campaigns.engines import LocalEngine

_START: Final = (
    "initial.position_m=[0.42,0.0,0.0]", "initial.attitude_deg=[0.0,0.0,0.0]", "requirements.required_ready_s=20.0",
    'requirements.required_parts=["control_precision","security"]',
)  # fmt: skip
CAUSES: Final[dict[str, tuple[tuple[str, ...], str, frozenset[str]]]] = {
    "two-sided bias": (
        ("dispersions.vmu.errors.bias_m={kind='normal',mean=0.0,sigma=[0.0,0.008,0.0]}",
         "rig.guard.enabled=false", "requirements.radial_distance_m=0.012"),
        "deviation", frozenset({"vmu.errors.bias_m[1]"}),
    ),
    "product": (
        ("dispersions.chaser.thrusters.force_n={kind='uniform',low=0.5,high=2.0,relative=true}",
         "dispersions.chaser.thrusters.minimum_on_s={kind='uniform',low=0.02,high=0.08}",
         "requirements.propellant_factor=4.0", "requirements.required_parts=['energy']"),
        "propellant", frozenset({"chaser.thrusters.force_n", "chaser.thrusters.minimum_on_s"}),
    ),
    "threshold": (
        ("dispersions.vmu.sigma_position_m={kind='uniform',low=0.5,high=3.0,relative=true}",
         "requirements.radial_distance_m=0.005"),
        "deviation", frozenset({"vmu.sigma_position_m"}),
    ),
    "alarm limit": (
        ("integrity.alert_corridor_fraction=0.24",),
        "level_across", frozenset(),
    ),
    "start": (
        ("dispersions.initial.velocity_mps={kind='normal',sigma=[0.02,0.001,0.001]}",),
        "closing_rate", frozenset({"initial.velocity_mps[0]"}),
    ),
}  # fmt: skip
"""Name -> settings, begin of the limit's name, dispersed numbers that decide (none: the limit itself)."""
_WITHOUT_EFFECT: Final = """
name = "without-effect"
sampling = "random"
[initial]
position_m = { kind = "normal", sigma = 1e-7 }
velocity_mps = { kind = "normal", sigma = 1e-9 }
attitude_deg = { kind = "normal", sigma = 1e-6 }
rate_degps = { kind = "normal", sigma = 1e-8 }
[truth]
centre_of_mass_offset_m = { kind = "normal", sigma = 1e-9 }
[chaser]
mass_kg = { kind = "normal", sigma = 1e-9, relative = true }
[chaser.thrusters]
force_n = { kind = "normal", sigma = 1e-9, relative = true }
[imu]
gyro_noise_degps = { kind = "uniform", low = 0.999999, high = 1.000001, relative = true }
accelerometer_noise_mps2 = { kind = "uniform", low = 0.999999, high = 1.000001, relative = true }
[vmu]
sigma_position_m = { kind = "uniform", low = 0.999999, high = 1.000001, relative = true }
"""
NO_CAUSE: Final = ("requirements.radial_distance_m=0.0036",)
"""Settings with which noise alone decides, for dispersed numbers that have no effect."""


def without_cause(seed: int, folder: Path, runs: int = 200, workers: int = 2) -> dict[str, Any]:
    """Return the explanation of a campaign whose failures have no cause."""
    folder.mkdir()
    table = folder / "without-effect.toml"
    table.write_text(_WITHOUT_EFFECT)
    return explained((f"dispersions={table}", *NO_CAUSE), seed, folder / "cases", runs, workers)


def explained(settings: tuple[str, ...], seed: int, folder: Path, runs: int = 200, workers: int = 2) -> dict[str, Any]:
    """Return the explanation of the campaign with ``settings``, flown into ``folder``."""
    every = (*[text for text in settings if text.startswith("dispersions=")], *_START, *settings)
    job = CampaignJob(load_scenario("scheme-1", every), load_rig("mock", every), seed, 45.0)
    engine = LocalEngine(workers)
    try:
        with job.store(folder) as store:
            summary = job.run(store, runs, engine, lambda _: None)
    finally:
        engine.close()
    found: dict[str, Any] = summary["why"]
    return found


def is_named(found: dict[str, Any], limit: str, numbers: frozenset[str]) -> bool:
    """Return whether the first cause is the planted one, and the first drivers are ``numbers``."""
    if not found["causes"]:
        return False
    first = found["causes"][0]
    drivers = [each["name"] for each in first["drivers"]][: len(numbers)]
    return first["limit"].startswith(limit) and set(drivers) == numbers
