"""The whole check: plays the cases, judges the answers, and says what it found, a line each."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field
from typing import Any, Final

import numpy as np

from hil.config.scenario import Scenario
from hil.core.gnc_records import GncMode
from hil.core.messages import Array
from hil.gnc_check import test_cases
from hil.gnc_check.estimate import check_estimate
from hil.gnc_check.gnc_under_test import GncUnderTest
from hil.gnc_check.session import Played, play, pushes
from hil.gnc_check.test_cases import Change, CheckCase, Player, along
from hil.setup.gnc_setup import gnc_setup

_OFFSET_M: Final = 0.15
_TURN_RAD: Final = math.radians(2.0)
_DRIFT_MPS: Final = 0.015
_RATE_RADPS: Final = math.radians(0.3)
_ANSWERS: Final = 0.01  # of the time: a push that is larger, on the mean, is a reaction
_RESTLESS: Final = 0.25  # of the time, at rest on the reference
_FROM_S: Final = 2.0  # reactions count from here on
_AXES: Final = "xyz"
_A_DEGREE: Final = math.degrees(1.0)

_MISREADINGS: Final[dict[str, Change]] = {
    "reads quaternions with the scalar first": test_cases.scalar_first,
    "reads q_CH the other way round, as q_HC": test_cases.other_way_round,
    "takes a pose's position for the chaser's from the target": test_cases.chaser_from_target,
    "takes a pose's position for components in H": test_cases.in_h,
}


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at."""

    check: str
    passed: bool
    text: str


@dataclass
class Report:
    """What was found. answers: how long they took; estimate: errors of the estimate, empty without one."""

    partner: str
    findings: list[Finding] = field(default_factory=list)
    answers: dict[str, float] = field(default_factory=dict)
    estimate: dict[str, float] = field(default_factory=dict)

    @property
    def passed(self) -> bool:
        return all(finding.passed for finding in self.findings)

    def say(self, check: str, faults: Iterable[str], fine: str) -> bool:
        """Add each of ``faults``, or ``fine`` where there are none; return whether there are none."""
        found = list(dict.fromkeys(faults))
        self.findings += [Finding(check, False, text) for text in found] or [Finding(check, True, fine)]
        return not found

    def as_json(self) -> dict[str, Any]:
        return {"gnc": self.partner, "passed": self.passed, **{k: v for k, v in asdict(self).items() if k != "partner"}}


def check_gnc(partner: GncUnderTest, scenario: Scenario, watch: Callable[[str], None] = lambda _: None) -> Report:
    """Play everything to ``partner`` and return what was found. watch: is told what is being played."""
    return _Check(partner, scenario, watch).run()


class _Check:
    def __init__(self, partner: GncUnderTest, scenario: Scenario, watch: Callable[[str], None]) -> None:
        self.setup = gnc_setup(scenario)
        self._partner = partner
        self._player = Player(self.setup)
        self._watch = watch
        self._wanted = scenario.requirements
        self._played: list[Played] = []
        self._at_rest = np.zeros(6)  # what it pushes at rest on the reference
        self._astray: set[tuple[int, int]] = set()  # force or torque, axis: where it does not oppose an error
        self._silent: set[tuple[int, int]] = set()  # where it does nothing at all about one
        self.report = Report(partner.name)

    def run(self) -> Report:
        rest = self._play(CheckCase("at rest on the reference", 12.0, before=self._partner.modes))
        in_time = len(rest.took_s) > 0 and float(np.median(rest.took_s)) <= float(self.setup.step_s)
        if in_time:  # else it would take for ever, and there is enough to mend
            self._look_at_rest(rest)
            self._look_at_hold()
            signs_fit = self._look_at_signs()
            if not signs_fit:
                self._look_for_misreadings()
            self._look_at_sizes()
            if signs_fit:
                self._look_at_motion()
                self._look_at_poses()
                self._look_at_abort()
            self._look_at_estimate()
        self._look_at_answers()
        return self.report

    def _play(self, case: CheckCase, change: Change | None = None, keep: bool = True) -> Played:
        self._watch(case.name)
        played = play(self._partner, self._player, self.setup, case, change)
        if keep:
            self._played.append(played)
        return played

    def _pushes(self, case: CheckCase, change: Change | None = None, keep: bool = True) -> Array:
        return self._play(case, change, keep).pushes(self.setup, _FROM_S)

    # -- what is looked at ---------------------------------------------------------------------------------------

    def _look_at_answers(self) -> None:
        """Numbers, cycles and time of all answers that were kept."""
        first: dict[int, str] = {}
        for played in self._played:
            for kind, (text, cycle) in played.faults.items():
                first.setdefault(kind, f"{text} (first in cycle {cycle} of case: {played.case.name})")
        faults = list(first.values())
        faults += [played.ended for played in self._played if played.ended]
        count = sum(len(played.outputs) for played in self._played)
        self.report.say("answers", faults, f"{count} answers with the right cycle and every number in its range")
        took_ms = 1e3 * np.concatenate([played.took_s for played in self._played])
        if not len(took_ms):
            return
        p50, p99, most = np.percentile(took_ms, (50, 99, 100))
        self.report.answers = {"count": count, "p50_ms": float(p50), "p99_ms": float(p99), "max_ms": float(most)}
        step_ms = 1e3 * float(self.setup.step_s)
        text = f"p50 {p50:.3g} ms, p99 {p99:.3g} ms, max {most:.3g} ms; a cycle has {step_ms:g} ms"
        rest = "; the rest was not played" if p50 > step_ms else ""
        late = [f"answers come late: {text}{rest}"] if p99 > step_ms else []
        self.report.say("time", late, f"answers in time: {text}")

    def _look_at_rest(self, rest: Played) -> None:
        """Thrusters at rest on the reference, and before time runs."""
        self._at_rest = rest.pushes(self.setup, _FROM_S)
        busy = np.abs(pushes(rest.outputs[rest.modes == GncMode.RUNNING], self.setup)).max(axis=1, initial=0.0) > 1e-6
        share = float(busy.mean()) if len(busy) else 0.0
        text = f"at rest on the reference thrusters fire for {100.0 * share:.0f} % of the time"
        self.report.say("quiet", [text] if share > _RESTLESS else [], text)
        self._say_quiet(rest)

    def _look_at_hold(self) -> None:
        self._say_quiet(
            self._play(CheckCase("held while it is off its reference", 6.0, along(1, _OFFSET_M), hold_s=5.0))
        )

    def _say_quiet(self, played: Played) -> None:
        for mode in sorted(set(played.modes.tolist()) - {GncMode.RUNNING}):
            fired = pushes(played.outputs[played.modes == mode], self.setup)
            name = GncMode(mode).name
            faults = [f"fires in {name}: thrusters open in RUNNING alone"] if np.abs(fired).max() > 1e-6 else []
            self.report.say("quiet", faults, f"thrusters are quiet in {name}")

    def _look_at_signs(self) -> bool:
        """Whether each offset and each turn is answered on its own axis, against it, on both sides."""
        for kind in (0, 1):
            for axis in range(3):
                faults, fine = self._judge_sign(kind, axis, None)
                if not self.report.say("sign", faults, fine):
                    self._astray.add((kind, axis))
        return not self._astray

    def _judge_sign(self, kind: int, axis: int, change: Change | None) -> tuple[list[str], str]:
        size = _TURN_RAD if kind else _OFFSET_M
        what = f"turn about {_AXES[axis]}" if kind else f"offset along {_AXES[axis]}"
        name, shown = ("torque", f"{math.degrees(size):g} deg") if kind else ("force", f"{size:g} m")
        kept = change is None
        answers = []
        for side in (1.0, -1.0):
            error = along(axis, side * size)
            where: dict[str, Any] = {"turn_rad": error} if kind else {"offset_m": error}
            answers.append(self._pushes(CheckCase(f"{what}, {shown}", **where), change, kept)[3 * kind : 3 * kind + 3])
        plus, minus = answers
        against = 0.5 * (minus - plus)  # the part that follows the error
        fine = f"{name} opposes a {what} ({shown})" if kind else f"{name} opposes an {what} ({shown})"
        article = "a" if kind else "an"
        if np.abs(answers).max() < _ANSWERS:
            if kept:
                self._silent.add((kind, axis))
            return [f"no {name} answers {article} {what} of {shown}"], fine
        largest = int(np.argmax(np.abs(against)))
        if abs(against[largest]) < _ANSWERS or (largest == axis and plus[axis] * minus[axis] > 0.0):
            return [
                f"{name} does not depend on the side of {article} {what}: it is the same at +{shown} and -{shown}"
            ], fine
        if largest != axis:
            return [f"{article} {what} is answered by a {name} {'about' if kind else 'along'} {_AXES[largest]}"], fine
        if against[axis] < 0.0:
            return [f"sign: the {name} drives {article} {what} on instead of opposing it"], fine
        return [], fine

    def _look_for_misreadings(self) -> None:
        """Say which way of misreading the inputs explains wrong signs: told that way, they fit."""
        for text, change in _MISREADINGS.items():
            if all(not self._judge_sign(kind, axis, change)[0] for kind in (0, 1) for axis in range(3)):
                self.report.say("misread", [f"all signs fit once inputs are told so: it {text}"], "")
                return

    def _look_at_sizes(self) -> None:
        """Errors far within Table III that are answered, and ones beyond it that are not: a unit is mistaken."""
        wanted = self._wanted
        faults = []
        for axis in range(3):
            about, beside = f"about {_AXES[axis]}", f"along {_AXES[axis]}"
            limit = math.radians(wanted.angle_deg)
            small, large = 0.8 * limit / _A_DEGREE, 2.0 * limit
            if self._reacts(CheckCase(f"small turn {about}", turn_rad=along(axis, small)), 3 + axis):
                faults.append(
                    f"answers a turn of {math.degrees(small):.2g} deg {about}, where {wanted.angle_deg:g} deg are "
                    "allowed: are radians taken for degrees somewhere (57 times too much)?"
                )
            elif self._ignores(CheckCase(f"turn {about}", turn_rad=along(axis, large)), 1, axis):
                far = self._reacts(CheckCase(f"large turn {about}", turn_rad=along(axis, 0.5)), 3 + axis)
                hint = ", but one of 29 deg: are degrees taken for radians (57 times too little)?" if far else ""
                faults.append(f"does not answer a turn of {math.degrees(large):g} deg {about}{hint}")
            limit = wanted.radial_distance_m
            small, large = 2e-3 * limit, 3.0 * limit
            if self._reacts(CheckCase(f"small offset {beside}", offset_m=along(axis, small)), axis):
                faults.append(
                    f"answers an offset of {1e3 * small:.2g} mm {beside}, where {1e3 * limit:g} mm are allowed: "
                    "are metres taken for millimetres somewhere?"
                )
            elif self._ignores(CheckCase(f"offset {beside}", offset_m=along(axis, large)), 0, axis):
                faults.append(f"does not answer an offset of {1e3 * large:g} mm {beside}")
        text = f"quiet at small errors, not at {2.0 * wanted.angle_deg:g} deg and {3e3 * wanted.radial_distance_m:g} mm"
        self.report.say("size", faults, text)

    def _reacts(self, case: CheckCase, place: int) -> bool:
        """Return whether an axis pushes otherwise than at rest."""
        return bool(abs(self._pushes(case)[place] - self._at_rest[place]) > _ANSWERS)

    def _ignores(self, case: CheckCase, kind: int, axis: int) -> bool:
        """Return whether an axis that does not go astray does nothing about the case's error."""
        if (kind, axis) in self._astray - self._silent:
            return False
        return bool(abs(self._pushes(case)[3 * kind + axis]) < _ANSWERS)

    def _look_at_motion(self) -> None:
        """Drifts and rates from the reference on: damped."""
        faults = []
        for axis in range(3):
            drift = self._pushes(CheckCase(f"drift along {_AXES[axis]}", drift_mps=along(axis, _DRIFT_MPS)))
            if drift[axis] > -_ANSWERS:
                faults.append(f"force does not oppose a drift of {1e3 * _DRIFT_MPS:g} mm/s along {_AXES[axis]}")
            rate = self._pushes(CheckCase(f"rate about {_AXES[axis]}", rate_radps=along(axis, _RATE_RADPS)))
            if rate[3 + axis] > -_ANSWERS:
                faults.append(
                    f"torque does not oppose a rate of {math.degrees(_RATE_RADPS):g} deg/s about {_AXES[axis]}"
                )
        self.report.say("motion", faults, "force opposes a drift along each axis, torque a rate about each axis")

    def _look_at_poses(self) -> None:
        """Poses that come late, and none any more: the force still opposes what there is."""
        faults = []
        cases_ = (
            CheckCase("poses 0.5 s late", 10.0, along(1, _OFFSET_M), late_s=0.5),
            CheckCase("no pose after 4 s", 10.0, along(1, _OFFSET_M), blind_s=4.0),
        )
        for case in cases_:
            played = self._play(case)
            if played.pushes(self.setup, _FROM_S)[1] > -_ANSWERS and not played.ended:
                faults.append(f"{case.name}: force does not oppose an offset along y any more")
        self.report.say("poses", faults, "goes on with poses that are 0.5 s late, and for 6 s without any")

    def _look_at_abort(self) -> None:
        played = self._play(CheckCase("an abort: the reference retreats along x", 12.0, abort_s=4.0))
        push = played.pushes(self.setup, 6.0)[0]
        text = "after an abort it does not follow the reference, which retreats along +x"
        self.report.say("abort", [text] if push < _ANSWERS and not played.ended else [], "follows an abort's retreat")

    def _look_at_estimate(self) -> None:
        case = CheckCase(
            "off on all axes and drifting",
            20.0,
            (0.12, -0.08, 0.1),
            (0.004, 0.003, -0.005),
            (math.radians(3.0), math.radians(-4.0), math.radians(5.0)),
            (math.radians(0.08), math.radians(-0.06), math.radians(0.07)),
        )
        played = self._play(case)
        known = np.flatnonzero((played.outputs["estimate"] == 1) & (played.modes == GncMode.RUNNING))
        if played.ended:
            return
        if not len(known) or known[-1] < len(played.outputs) - 1:
            self.report.say("estimate", [], "gives no estimate: nothing can be supervised, docking is never a go")
            return
        faults, self.report.estimate = check_estimate(
            played.outputs[known[-1]], self._player.truth(case, float(played.t_s[known[-1]]))
        )
        errors = self.report.estimate
        text = f"estimate within {1e3 * errors['position_m']:.1f} mm and {errors['attitude_deg']:.3f} deg of the truth"
        self.report.say("estimate", faults, text)
