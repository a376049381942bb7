"""``hil vehicle``: what the thrusters give against what plan, requirement, abort and go take, before a run."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hil.cli.options import Figure, File, Settings
from hil.cli.output import deliver, print_columns, say

if TYPE_CHECKING:
    from hil.config.rig import Rig
    from hil.config.scenario import Scenario


def vehicle(
    scenario: str = "scheme-1", /, *, rig: str = "mock", settings: Settings = (), image: Figure = None,
    json: File = None,
) -> int:  # fmt: skip
    """Compare the vehicle of a scenario with its plan, Table III, and abort.

    Exit code 2 if it cannot fly the plan.

    Parameters
    ----------
    scenario
        Shipped scenario, or the path of a file.
    rig
        Rate of the vision unit: mock, emulated, or the path of a rig file.
    image
        File for the forces and torques that the thrusters can give, *.svg, *.png or *.pdf.
    json
        File for the numbers, - for standard output.
    """
    from hil.checks.abort import check_abort
    from hil.checks.compatibility import check_plan
    from hil.checks.ephemeris import ephemeris_warnings
    from hil.checks.go_level import go_warnings
    from hil.config.load import load_rig, load_scenario
    from hil.errors import BadInput

    loaded, loaded_rig = load_scenario(scenario, settings), load_rig(rig, settings)
    numbers = _numbers(loaded.value, loaded_rig.value)
    warnings = go_warnings(loaded.value, loaded_rig.value)
    ages = ephemeris_warnings(loaded.value, loaded_rig.value, loaded.value.duration_s)

    def show() -> None:
        _show(numbers)
        for line in warnings:
            say(f"no go: {line}")
        for line in ages:
            say(line)

    deliver({"scenario": loaded.value.name, **numbers, "no_go": warnings, "orbit": ages}, json, show)
    if image is not None:
        from hil.report.authority_figure import authority_figure

        authority_figure(loaded.value).savefig(image)
    if problems := check_plan(loaded, loaded_rig) or check_abort(loaded):
        raise BadInput(problems)
    return 0


def _numbers(scenario: Scenario, rig: Rig) -> dict[str, Any]:
    """Return the numbers of the page by the keys of its JSON."""
    import numpy as np

    from hil.checks.abort import failed_thrusters
    from hil.checks.go_level import predicted_hold
    from hil.checks.modes import mode_swings
    from hil.checks.vehicle import authority, phase_demands
    from hil.params.gnc import abort_brake, braking_acceleration

    given = authority(scenario)
    per_axis = [
        {
            "axis": f"{'about' if k >= 3 else 'along'} {'xyz'[k % 3]}",
            "unit": "deg/s2" if k >= 3 else "m/s2",
            "demand": float(value[0]),
            "one_dead": float(value[1]),
            "full": None if k >= 3 else float(given.full[k]),
        }
        for k, value in enumerate(
            np.array([given.demand, given.dead]).T * np.where(np.arange(6) < 3, 1.0, np.degrees(1.0))[:, None]
        )
    ]
    worst = min(failed_thrusters(scenario), key=lambda failed: failed.braking_mps2)
    return {
        "authority": per_axis,
        "phases": [each._asdict() for each in phase_demands(scenario)],
        "modes": [swing._asdict() for swing in mode_swings(scenario)],
        "hold": [axis._asdict() | {"level": axis.level or None} for axis in predicted_hold(scenario, rig)],
        "abort": {
            "brake_mps2": scenario.gnc.abort.brake_mps2,
            "given_mps2": braking_acceleration(scenario),
            "flown_mps2": abort_brake(scenario),
            "one_failed_mps2": worst.braking_mps2,
            "failure": f"thruster.{worst.number} {worst.kind}",
        },
        "go_valid_s": scenario.requirements.go_valid_s,
        "go_alarm_interval_s": scenario.gnc.integrity.go_alarm_interval_s,
    }


def _show(numbers: dict[str, Any]) -> None:
    """Print the page."""
    rows = [
        (
            row["axis"],
            row["unit"],
            *("-" if row[name] is None else f"{row[name]:.3g}" for name in ("demand", "one_dead", "full")),
        )
        for row in numbers["authority"]
    ]
    print_columns(("thrusters give", "", "of a demand", "one dead", "all that push"), rows, left=(0, 1))
    taken = [
        (
            each["phase"],
            f"along {'xyz'[each['axis']]}",
            f"{each['needed_mps2']:.3g}",
            f"{each['given_mps2']:.3g}",
            each["key"],
        )
        for each in numbers["phases"]
    ]
    print_columns(("plan takes, m/s2", "", "at most", "given", "key"), taken, left=(0, 1, 4))
    held = [
        (
            axis["name"], axis["unit"], f"{axis['change']:.3g}", f"{axis['change_max']:g}", f"{axis['held']:.3g}",
            "-" if axis["level"] is None else f"{axis['level']:.3g}", f"{axis['tolerance']:g}",
            f"{axis['amplitude']:.3g}", f"{axis['period_s']:.3g}", f"{axis['propellant_kgph']:.3g}",
        )
        for axis in numbers["hold"]
    ]  # fmt: skip
    head = (
        "ready state", "", "firing changes rate by", "allowed", "held within", "level of a go", "allowed",
        "limit cycle +-", "period, s", "kg/h",
    )  # fmt: skip
    print_columns(head, held, left=(0, 1))
    for mode in numbers["modes"]:
        say(
            f"mode {mode['mode']}, {mode['frequency_hz']:g} Hz: smallest firings swing the hub {mode['axis']} by "
            f"{mode['swing']:.2g} {mode['unit']}, allowed {mode['allowed']:.2g}"
        )
    abort = numbers["abort"]
    say(
        f"abort brakes with {abort['flown_mps2']:.3g} m/s2 of {abort['given_mps2']:.3g} (gnc.abort.brake_mps2 "
        f"{abort['brake_mps2']:g}), with {abort['failure']} {abort['one_failed_mps2']:.3g}"
    )
    say(
        f"a go is promised for {numbers['go_valid_s']:g} s, and withdrawn by the innovations of sound poses once in "
        f"{numbers['go_alarm_interval_s']:g} s"
    )
