"""Check of an external GNC: plays the cases, evaluates the replies and reports its findings, one line each."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field
from typing import Any, Final

import numpy as np

from hil.config.scenario import Scenario
from hil.core.gnc_records import GncMode
from hil.core.messages import Array
from hil.parts.links.gnc_check import test_cases
from hil.parts.links.gnc_check.estimate import check_estimate
from hil.parts.links.gnc_check.gnc_under_test import GncUnderTest, Played, play, pushes
from hil.parts.links.gnc_check.test_cases import Change, CheckCase, Player, along
from hil.session.gnc_setup import gnc_setup

_OFFSET_M: Final = 0.15
_ROTATION_RAD: Final = math.radians(2.0)
_DRIFT_MPS: Final = 0.015
_RATE_RADPS: Final = math.radians(0.3)
_REACTION: Final = 0.01  # mean fraction of the time above which a push counts as a reaction
_BUSY: Final = 0.25  # fraction of the time that thrusters may fire at rest on the reference
_DELAY_S: Final = 4.0  # duration of the case that measures the delay
_FROM_S: Final = 2.0  # reactions count from here on
_AXES: Final = "xyz"
_A_DEGREE: Final = math.degrees(1.0)

_MISREADINGS: Final[dict[str, Change]] = {
    "reads quaternions with the scalar first": test_cases.scalar_first,
    "reads q_CH as its inverse, q_HC": test_cases.inverse_quaternions,
    "takes a pose's position for the chaser's from the target": test_cases.chaser_from_target,
    "takes a pose's position for components in H": test_cases.in_h,
}


@dataclass(frozen=True)
class Finding:
    """Result of one check."""

    check: str
    passed: bool
    text: str


@dataclass
class Report:
    """Results of all checks. answers: their times; estimate: errors of the estimate, empty if there is none."""

    gnc: str
    findings: list[Finding] = field(default_factory=list)
    answers: dict[str, float] = field(default_factory=dict)
    estimate: dict[str, float] = field(default_factory=dict)

    @property
    def passed(self) -> bool:
        return all(finding.passed for finding in self.findings)

    def add(self, check: str, faults: Iterable[str], fine: str) -> bool:
        """Add each of ``faults``, or ``fine`` if there are none; return whether there are none."""
        texts = list(dict.fromkeys(faults))
        self.findings += [Finding(check, False, text) for text in texts] or [Finding(check, True, fine)]
        return not texts

    def as_json(self) -> dict[str, Any]:
        return {"gnc": self.gnc, "passed": self.passed, **{k: v for k, v in asdict(self).items() if k != "gnc"}}


def check_gnc(gnc: GncUnderTest, scenario: Scenario, watch: Callable[[str], None] = lambda _: None) -> Report:
    """Play all cases to ``gnc`` and return the report. watch: called with the name of each case."""
    return _Check(gnc, scenario, watch).run()


class _Check:
    def __init__(self, gnc: GncUnderTest, scenario: Scenario, watch: Callable[[str], None]) -> None:
        self.setup = gnc_setup(scenario)
        self._gnc = gnc
        self._player = Player(self.setup)
        self._watch = watch
        self._wanted = scenario.requirements
        self._played: list[Played] = []
        self._at_rest = np.zeros(6)  # mean push at rest on the reference
        self._astray: set[tuple[int, int]] = set()  # force or torque, axis: of those that do not oppose an error
        self._silent: set[tuple[int, int]] = set()  # of those that do not react to one
        self.report = Report(gnc.name)

    def run(self) -> Report:
        rest = self._play(CheckCase("at rest on the reference", 12.0, before=self._gnc.modes))
        in_time = len(rest.took_s) > 0 and float(np.median(rest.took_s)) <= float(self.setup.step_s)
        if in_time:  # otherwise the rest would take too long
            self._check_rest(rest)
            self._check_hold()
            self._check_delay()
            signs_fit = self._check_signs()
            if not signs_fit:
                self._check_misreadings()
            self._check_sizes()
            if signs_fit:
                self._check_motion()
                self._check_poses()
                self._check_abort()
            self._check_estimate()
        self._check_answers()
        return self.report

    def _play(self, case: CheckCase, change: Change | None = None, keep: bool = True) -> Played:
        self._watch(case.name)
        played = play(self._gnc, self._player, self.setup, case, change)
        if keep:
            self._played.append(played)
        return played

    def _pushes(self, case: CheckCase, change: Change | None = None, keep: bool = True) -> Array:
        return self._play(case, change, keep).pushes(self.setup, _FROM_S)

    # -- checks ---------------------------------------------------------------------------------------

    def _check_answers(self) -> None:
        """Numbers, cycles and time of all answers that were kept."""
        first: dict[int, str] = {}
        for played in self._played:
            for kind, (text, cycle) in played.faults.items():
                first.setdefault(kind, f"{text} (first in cycle {cycle} of case: {played.case.name})")
        faults = list(first.values())
        faults += [played.ended for played in self._played if played.ended]
        count = sum(len(played.outputs) for played in self._played)
        self.report.add("answers", faults, f"{count} answers with the right cycle and every number in its range")
        took_ms = 1e3 * np.concatenate([played.took_s for played in self._played])
        if not len(took_ms):
            return
        p50, p99, most = np.percentile(took_ms, (50, 99, 100))
        self.report.answers = {"count": count, "p50_ms": float(p50), "p99_ms": float(p99), "max_ms": float(most)}
        step_ms = 1e3 * float(self.setup.step_s)
        text = f"p50 {p50:.3g} ms, p99 {p99:.3g} ms, max {most:.3g} ms; a cycle has {step_ms:g} ms"
        rest = "; the rest was not played" if p50 > step_ms else ""
        late = [f"answers come late: {text}{rest}"] if p99 > step_ms else []
        self.report.add("time", late, f"answers in time: {text}")

    def _check_rest(self, rest: Played) -> None:
        """Check the thrusters at rest on the reference, and before the run's time starts."""
        self._at_rest = rest.pushes(self.setup, _FROM_S)
        busy = np.abs(pushes(rest.outputs[rest.modes == GncMode.RUNNING], self.setup)).max(axis=1, initial=0.0) > 1e-6
        busy_fraction = float(busy.mean()) if len(busy) else 0.0
        text = f"at rest on the reference thrusters fire for {100.0 * busy_fraction:.0f} % of the time"
        self.report.add("quiet", [text] if busy_fraction > _BUSY else [], text)
        self._check_quiet(rest)

    def _check_hold(self) -> None:
        self._check_quiet(
            self._play(CheckCase("hold with an offset from the reference", 6.0, along(1, _OFFSET_M), hold_s=5.0))
        )

    def _check_quiet(self, played: Played) -> None:
        for mode in sorted(set(played.modes.tolist()) - {GncMode.RUNNING}):
            fired = pushes(played.outputs[played.modes == mode], self.setup)
            name = GncMode(mode).name
            faults = [f"fires in {name}: thrusters open in RUNNING alone"] if np.abs(fired).max() > 1e-6 else []
            self.report.add("quiet", faults, f"thrusters are quiet in {name}")

    def _check_delay(self) -> None:
        """Report the number of cycles from a change of the inputs to the first output that it changes."""
        case = CheckCase("a step of reference and gyro", _DELAY_S)
        steps_at = round(0.5 * _DELAY_S / float(self.setup.step_s))
        plain = self._play(case, keep=False)
        stepped = self._play(case, test_cases.step_at(steps_at, _OFFSET_M, _RATE_RADPS), keep=False)
        n = min(len(plain.outputs), len(stepped.outputs))
        changed = [k for k in range(n) if plain.outputs[k].tobytes() != stepped.outputs[k].tobytes()]
        if not changed or plain.ended or stepped.ended:
            return  # other checks report it
        late = changed[0] - steps_at
        text = "outputs answer the input of their own cycle"
        if late > 0:
            late_ms = 1e3 * late * float(self.setup.step_s)
            text = f"outputs come {late} cycle{'s' * (late > 1)} ({late_ms:g} ms) after the input that they answer"
        self.report.add("delay", [], text)

    def _check_signs(self) -> bool:
        """Return whether each offset and rotation is opposed on its own axis, on both sides."""
        for kind in (0, 1):
            for axis in range(3):
                faults, fine = self._check_sign(kind, axis, None)
                if not self.report.add("sign", faults, fine):
                    self._astray.add((kind, axis))
        return not self._astray

    def _check_sign(self, kind: int, axis: int, change: Change | None) -> tuple[list[str], str]:
        size = _ROTATION_RAD if kind else _OFFSET_M
        what = f"rotation about {_AXES[axis]}" if kind else f"offset along {_AXES[axis]}"
        name, shown = ("torque", f"{math.degrees(size):g} deg") if kind else ("force", f"{size:g} m")
        kept = change is None
        answers = []
        for side in (1.0, -1.0):
            error = along(axis, side * size)
            where: dict[str, Any] = {"rotation_rad": error} if kind else {"offset_m": error}
            answers.append(self._pushes(CheckCase(f"{what}, {shown}", **where), change, kept)[3 * kind : 3 * kind + 3])
        plus, minus = answers
        against = 0.5 * (minus - plus)  # the part that follows the error
        fine = f"{name} opposes a {what} ({shown})" if kind else f"{name} opposes an {what} ({shown})"
        article = "a" if kind else "an"
        if np.abs(answers).max() < _REACTION:
            if kept:
                self._silent.add((kind, axis))
            return [f"no {name} answers {article} {what} of {shown}"], fine
        largest = int(np.argmax(np.abs(against)))
        if abs(against[largest]) < _REACTION or (largest == axis and plus[axis] * minus[axis] > 0.0):
            return [
                f"{name} does not depend on the side of {article} {what}: it is the same at +{shown} and -{shown}"
            ], fine
        if largest != axis:
            return [f"{article} {what} is answered by a {name} {'about' if kind else 'along'} {_AXES[largest]}"], fine
        if against[axis] < 0.0:
            return [f"sign: the {name} drives {article} {what} on instead of opposing it"], fine
        return [], fine

    def _check_misreadings(self) -> None:
        """Report the misinterpretation of the inputs that explains wrong signs: with inputs changed so, they fit."""
        for text, change in _MISREADINGS.items():
            if all(not self._check_sign(kind, axis, change)[0] for kind in (0, 1) for axis in range(3)):
                self.report.add("misread", [f"all signs fit if the inputs are changed accordingly: it {text}"], "")
                return

    def _check_sizes(self) -> None:
        """Check for mistaken units: reactions to errors far within Table III, none to errors beyond it."""
        requirements = self._wanted
        faults = []
        for axis in range(3):
            about, along_axis = f"about {_AXES[axis]}", f"along {_AXES[axis]}"
            limit = math.radians(requirements.angle_deg)
            small, large = 0.8 * limit / _A_DEGREE, 2.0 * limit
            if self._reacts(CheckCase(f"small rotation {about}", rotation_rad=along(axis, small)), 3 + axis):
                faults.append(
                    f"reacts to a rotation of {math.degrees(small):.2g} deg {about}, allowed "
                    f"{requirements.angle_deg:g} deg: are radians taken for degrees somewhere (57 times too much)?"
                )
            elif self._ignores(CheckCase(f"rotation {about}", rotation_rad=along(axis, large)), 1, axis):
                far = self._reacts(CheckCase(f"large rotation {about}", rotation_rad=along(axis, 0.5)), 3 + axis)
                hint = ", but to one of 29 deg: are degrees taken for radians (57 times too little)?" if far else ""
                faults.append(f"does not react to a rotation of {math.degrees(large):g} deg {about}{hint}")
            limit = requirements.radial_distance_m
            small, large = 2e-3 * limit, 3.0 * limit
            if self._reacts(CheckCase(f"small offset {along_axis}", offset_m=along(axis, small)), axis):
                faults.append(
                    f"reacts to an offset of {1e3 * small:.2g} mm {along_axis}, allowed {1e3 * limit:g} mm: "
                    "are metres taken for millimetres somewhere?"
                )
            elif self._ignores(CheckCase(f"offset {along_axis}", offset_m=along(axis, large)), 0, axis):
                faults.append(f"does not react to an offset of {1e3 * large:g} mm {along_axis}")
        text = f"no reaction to small errors, but to {2.0 * requirements.angle_deg:g} deg and "
        text += f"{3e3 * requirements.radial_distance_m:g} mm"
        self.report.add("size", faults, text)

    def _reacts(self, case: CheckCase, index: int) -> bool:
        """Return whether an axis pushes differently than at rest."""
        return bool(abs(self._pushes(case)[index] - self._at_rest[index]) > _REACTION)

    def _ignores(self, case: CheckCase, kind: int, axis: int) -> bool:
        """Return whether an axis without a sign error does not react to the case's error."""
        if (kind, axis) in self._astray - self._silent:
            return False
        return bool(abs(self._pushes(case)[3 * kind + axis]) < _REACTION)

    def _check_motion(self) -> None:
        """Check that drifts and rates are damped."""
        faults = []
        for axis in range(3):
            drift = self._pushes(CheckCase(f"drift along {_AXES[axis]}", drift_mps=along(axis, _DRIFT_MPS)))
            if drift[axis] > -_REACTION:
                faults.append(f"force does not oppose a drift of {1e3 * _DRIFT_MPS:g} mm/s along {_AXES[axis]}")
            rate = self._pushes(CheckCase(f"rate about {_AXES[axis]}", rate_radps=along(axis, _RATE_RADPS)))
            if rate[3 + axis] > -_REACTION:
                faults.append(
                    f"torque does not oppose a rate of {math.degrees(_RATE_RADPS):g} deg/s about {_AXES[axis]}"
                )
        self.report.add("motion", faults, "force opposes a drift along each axis, torque a rate about each axis")

    def _check_poses(self) -> None:
        """Check that the force opposes an offset with late poses, and after the last pose."""
        faults = []
        cases_ = (
            CheckCase("poses 0.5 s late", 10.0, along(1, _OFFSET_M), late_s=0.5),
            CheckCase("no pose after 4 s", 10.0, along(1, _OFFSET_M), blind_s=4.0),
        )
        for case in cases_:
            played = self._play(case)
            if played.pushes(self.setup, _FROM_S)[1] > -_REACTION and not played.ended:
                faults.append(f"{case.name}: force no longer opposes an offset along y")
        self.report.add("poses", faults, "works with poses that are 0.5 s late, and for 6 s without poses")

    def _check_abort(self) -> None:
        played = self._play(CheckCase("an abort: the reference retreats along x", 12.0, abort_s=4.0))
        push = played.pushes(self.setup, 6.0)[0]
        text = "after an abort it does not follow the reference, which retreats along +x"
        self.report.add("abort", [text] if push < _REACTION and not played.ended else [], "follows an abort's retreat")

    def _check_estimate(self) -> None:
        case = CheckCase(
            "off on all axes and drifting",
            20.0,
            (0.12, -0.08, 0.1),
            (0.004, 0.003, -0.005),
            (math.radians(3.0), math.radians(-4.0), math.radians(5.0)),
            (math.radians(0.08), math.radians(-0.06), math.radians(0.07)),
        )
        played = self._play(case)
        estimated = np.flatnonzero((played.outputs["estimate"] == 1) & (played.modes == GncMode.RUNNING))
        if played.ended:
            return
        if not len(estimated) or estimated[-1] < len(played.outputs) - 1:
            self.report.add(
                "estimate", [], "sends no estimate: the approach monitor has no input, docking is never a go"
            )
            return
        faults, self.report.estimate = check_estimate(
            played.outputs[estimated[-1]], self._player.truth(case, float(played.t_s[estimated[-1]]))
        )
        errors = self.report.estimate
        text = f"estimate within {1e3 * errors['position_m']:.1f} mm and {errors['attitude_deg']:.3f} deg of the truth"
        self.report.add("estimate", faults, text)
