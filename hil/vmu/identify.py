"""LED identification: selects the true pose among those that the spots allow, by the spots or by a track."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hil.vmu.ghosts import LensGhosts
from hil.vmu.kernels.hypotheses import difference
from hil.vmu.kernels.lens import in_image, project
from hil.vmu.kernels.records import FIT, MAX_SPOTS, View
from hil.vmu.pose import (
    OPTICS_PX,
    Prediction,
    Solver,
    SolverSettings,
    attitude_sigma_deg,
    fits_within_budget,
    is_flat,
    matrix_of,
)

OK: Final = "ok"
AMBIGUOUS: Final = "ambiguous"
TOO_FEW: Final = "too_few"
NO_MATCH: Final = "rejected_no_match"
GEOMETRY: Final = "rejected_geometry"
NOT_TOGETHER: Final = "rejected_sync"
GEOMETRY_FILE: Final = "rejected_geometry_file"

_GATE_6 = 33.0  # chi-square of six components that a true pose exceeds once in 100 000
_GATE_2 = 20.0  # as in matching
_TRACK_REACH_PX = 150.0
_MARKED_COST = 20.0
_FEW_DEGREES, _FEW_SIGMA = 6, 3.3
_BRIGHTER = 1.3
_SHIFTED = 4.5  # sigmas: shift between the two images
_APART = 12.0  # ratio of variances (6 and 12 degrees of freedom), which images of one moment exceed once in 5000
_OWN, _MORE = 5, 2  # least spots of a camera's own pattern, and by how many more than the best pose
_SECOND = 4  # LEDs, all by other lights, that make a second pattern
_FEWEST, _FEW_LIGHTS = 3, 5  # the same of three, if there are hardly any other lights
_FLUX_ALIKE, _FLUX_RANGE = 0.15, math.log(30.0)  # ln of the brightness: of LEDs, of other lights
_TWO_LIGHTS = 1.5  # times the usual flux: two lights may be one spot ...
_TWO_LIGHTS_PX = 6.0  # ... which is displaced
_RANDOM = 1.0  # ln of the number of patterns by other lights up to which a position is reported
_LIGHTS = 4  # least number of lights in an image that should show as many LEDs
_EDGE_PX = 4.0
_EPIPOLAR_PX = 3.0
_NEAR_TRACK = 20.0  # score by which a pose that continues a mature track may be below the best


@dataclass(frozen=True, slots=True)
class LedIdentification:
    """Result for one view. fit: FIT if the status is ``ok``. candidates: all poses that the spots allow.

    on_track: all candidates of an ``ambiguous`` one continue the track, whose identification holds; only the tilt is
    ambiguous. jump: the status is ``ambiguous`` only because the single pose that fits, the first candidate, does not
    continue a mature track. open: another pose than the candidates may be the true one.
    """

    status: str
    fit: np.void | None = None
    candidates: Sequence[np.void] = ()
    on_track: bool = False
    jump: bool = False
    open: bool = False


class Identifier:
    """Selects among the hypotheses."""

    def __init__(self, solver: Solver, marked_led: int | None) -> None:
        self._solver = solver
        self._settings: SolverSettings = solver.settings
        self._marked = marked_led
        self.ghosts = tuple(LensGhosts(np.array([lens["cx"], lens["cy"]])) for lens in solver.scene.lens)
        self._slack = max(float(solver.slack.max()) - OPTICS_PX**2, 0.0)

    def tracked(self, view: View, prediction: Prediction) -> LedIdentification | None:
        """Return the identification by the prediction's gates only, None if a search is needed."""
        r = matrix_of(prediction.q_vt)
        spots, contested = self._solver.expected(view, r, prediction.t_v, prediction.covariance, _TRACK_REACH_PX)
        if contested or (spots >= 0).sum() < 3:
            return None
        fits = self._solver.from_start(view, r, prediction.t_v, spots)
        verdict = self._by_track(view, fits, prediction)
        if verdict.fit is None or not self._complete(view, verdict.fit):
            return None
        better = float(fits["score"].max()) > float(verdict.fit["score"]) + self._settings.decisive
        together = np.abs(verdict.fit["shift"]).max() < _SHIFTED and fits_within_budget(verdict.fit)
        return verdict if not better and together else None

    def _complete(self, view: View, fit: np.void) -> bool:
        """Return whether no light near the pattern remains that could be an LED without a spot.

        A track on the wrong LEDs leaves some unassigned; then a search is needed.
        """
        if fit["removed"]:
            return False
        n_leds = len(self._solver.scene.leds)
        for c in range(2):
            used = [k for k in fit["spot"][c] if k >= 0]
            if len(used) < min(n_leds, int(view.counts[c])) and self._near_strays(view, used, c):
                return False
        return True

    def _near_strays(self, view: View, used: Sequence[int], camera: int) -> bool:
        spots = view.spots[camera, : view.counts[camera]]
        if not used:
            return len(spots) > 0
        away = np.hypot(spots["u"] - spots["u"][used].mean(), spots["v"] - spots["v"][used].mean())
        return int((away <= 1.5 * away[used].max()).sum()) > len(used)

    def search(self, view: View, prediction: Prediction | None, mature: bool = False) -> LedIdentification:
        """Return the identification over all hypotheses; the prediction is used only if the spots are ambiguous.

        mature: the prediction continues a long track, which a single pair of images does not overrule.
        """
        identification = self._by_hypotheses(view, prediction, mature)
        unknown = identification.status in (NO_MATCH, GEOMETRY, TOO_FEW) and view.counts.max() < MAX_SPOTS
        if unknown and (apart := self._each_alone(view)) != OK:
            return LedIdentification(apart)
        return identification

    def _by_hypotheses(self, view: View, prediction: Prediction | None, mature: bool) -> LedIdentification:
        if max(view.counts) < 3:
            return LedIdentification(TOO_FEW)
        fits, all_kept = self._solver.hypotheses(view, prediction)
        if not len(fits):
            return LedIdentification(NO_MATCH if max(view.counts) > 3 else TOO_FEW)
        fits = fits[[self._possible(fit) for fit in fits]]
        if not len(fits):
            return LedIdentification(GEOMETRY)
        alone = self._by_spots(view, fits)
        if alone.fit is not None:
            if (apart := self._apart(view, fits, alone.fit)) != OK:
                return LedIdentification(apart, candidates=alone.candidates)
            if not all_kept and int(alone.fit["points"]) < 2 * len(self._solver.scene.leds) - 1:
                alone = LedIdentification(
                    AMBIGUOUS, candidates=alone.candidates, open=True
                )  # of one that was not tried
            elif len(second := self._second_pattern(view, alone.candidates[0])):
                alone = LedIdentification(AMBIGUOUS, candidates=[*alone.candidates, *second], open=True)
        elif (apart := self._apart(view, fits, alone.candidates[0])) != OK:
            alone = LedIdentification(apart, candidates=alone.candidates)
        if prediction is None or (alone.fit is not None and not mature):
            return alone
        tracked = self._by_track(view, self._with_predicted(view, fits, prediction), prediction)
        if alone.fit is None:
            if tracked.fit is not None and self._apart(view, fits, tracked.fit) == OK:
                return tracked
            return tracked if tracked.on_track else alone
        if distance_square(alone.fit, prediction) < _GATE_6:
            return alone
        if tracked.fit is not None and (
            tracked.fit["score"] > alone.fit["score"] - _NEAR_TRACK or not shares_spots(tracked.fit, alone.fit)
        ):
            return tracked
        return LedIdentification(AMBIGUOUS, candidates=[alone.fit], jump=True)

    def partly(self, view: View, verdict: LedIdentification) -> bool:
        """Return whether one of the candidates of ``verdict`` is the true pose, so that what they agree on is known.

        The lights have to belong to the LEDs: hardly any to another pattern, none that the best candidate leaves out
        near it, and none at all with three LEDs, which other lights may be as well.
        """
        if verdict.open or verdict.jump or not verdict.candidates or not fits_within_budget(verdict.candidates[0]):
            return False
        best = verdict.candidates[0]
        used = (best["spot"] >= 0).sum(axis=1)
        if self._log_false_alarms(view, best, None) > _RANDOM or used.min() < 2:
            return False
        if (best["spot"] >= 0).any(axis=0).sum() < _SECOND:
            return bool((used == view.counts).all())
        strays = any(self._near_strays(view, [k for k in best["spot"][c] if k >= 0], c) for c in range(2))
        return not strays and not len(self._second_pattern(view, best))

    def _second_pattern(self, view: View, best: np.void) -> np.ndarray:
        """Return the poses of other LEDs by the lights that ``best`` does not use, (n,) of FIT.

        A reflection of the ring, or a second ring, is a pattern like the ring itself, and may be the more complete one.
        Where both touch, two lights are one spot: to three lights each LED of ``best`` is added in turn.
        """
        rest = self._without_ghosts(view, best)
        if rest.counts.min() >= _SECOND or rest.counts.max() >= _OWN:
            patterns = self._patterns(rest, _SECOND)
            patterns = patterns if len(patterns) else self._touching(rest)
            if len(patterns):
                return patterns
        if rest.counts.min() < _FEWEST:
            return np.zeros(0, FIT)
        if rest.counts.max() <= _FEW_LIGHTS and len(patterns := self._patterns(rest, _FEWEST)):
            return patterns
        if rest.counts.min() >= _SECOND:
            return np.zeros(0, FIT)
        for n in np.flatnonzero((best["spot"] >= 0).all(axis=0)):
            others = best.copy()
            others["spot"][:, n] = -1
            if len(patterns := self._patterns(self._without_ghosts(view, others), _SECOND)):
                return patterns
        return np.zeros(0, FIT)

    def _without_ghosts(self, view: View, best: np.void) -> View:
        """Return ``view`` without the lights of the pose ``best`` and without what the lenses make of them."""
        rest = without_spots(view, best)
        for c, ghosts in enumerate(self.ghosts):
            leds, lights = view.spots[c, best["spot"][c][best["spot"][c] >= 0]], rest.spots[c, : rest.counts[c]]
            kept = np.flatnonzero(~ghosts.among(leds, lights))
            rest.spots[c, : len(kept)], rest.counts[c] = lights[kept], len(kept)
        return rest

    def _patterns(self, rest: View, least: int) -> np.ndarray:
        """Return the poses of at least ``least`` LEDs by the lights ``rest`` that are more likely a ring than chance.

        To doubt a pose takes less than to accept one: ``doubt`` against ``false_alarms``.
        """
        fits, _ = self._solver.hypotheses(rest, level=least)
        leds = (fits["spot"] >= 0).any(axis=1).sum(axis=1)
        most = math.log(self._settings.doubt)
        return fits[
            [
                bool(n >= least and self._possible(fit) and self._log_chance(rest, fit) <= most)
                for fit, n in zip(fits, leds, strict=True)
            ]
        ]

    def _log_chance(self, view: View, fit: np.void) -> float:
        """Return ln of the expected number of such patterns of lights that are as much alike, made at random.

        Other lights have any brightness within a factor of thirty.
        """
        total = self._log_false_alarms(view, fit, None)
        for c in range(2):
            flux = np.log(view.spots["flux"][c, fit["spot"][c][fit["spot"][c] >= 0]])
            if len(flux) > 1:
                apart = max(float(np.ptp(flux)), _FLUX_ALIKE)
                total += (len(flux) - 1) * math.log(min(1.0, 2.0 * apart / _FLUX_RANGE))
        return total

    def _touching(self, rest: View) -> np.ndarray:
        """Return the poses of three LEDs by the lights ``rest`` with a fourth at one that is brighter than most.

        That is of two lights, which displaces it by up to half their distance.
        """
        if rest.counts.min() < _SECOND:
            return np.zeros(0, FIT)
        bright, plain = [], np.zeros_like(rest.spots)
        counts = np.zeros_like(rest.counts)
        for c, n in enumerate(rest.counts):
            spots = rest.spots[c, :n]
            is_bright = spots["flux"] > _TWO_LIGHTS * np.median(spots["flux"])
            bright.append(spots[is_bright])
            counts[c] = n - len(bright[c])
            plain[c, : counts[c]] = spots[~is_bright]
        if min(map(len, bright)) == 0 or counts.min() < _SECOND - 1:
            return np.zeros(0, FIT)
        fits, _ = self._solver.hypotheses(rest._replace(spots=plain, counts=counts), level=_SECOND - 1)
        return fits[[self._possible(fit) and fits_within_budget(fit) and self._shows(fit, bright) for fit in fits]]

    def _shows(self, fit: np.void, lights: Sequence[np.ndarray]) -> bool:
        """Return whether an LED without a spot is near one of ``lights`` in both cameras."""
        pixels = [self._projected(fit, c) for c in range(2)]
        return any(
            all(np.hypot(*(np.column_stack([spots["u"], spots["v"]]) - at[n]).T).min() < _TWO_LIGHTS_PX
                for spots, at in zip(lights, pixels, strict=True))
            for n in np.flatnonzero((fit["spot"][:, : len(pixels[0])] < 0).all(axis=0))
        )  # fmt: skip

    def _projected(self, fit: np.void, camera: int) -> np.ndarray:
        """Return the pixels (n, 2) of all LEDs in a camera by the pose ``fit``."""
        scene = self._solver.scene
        own = (scene.leds @ fit["r"].T + fit["t"]) @ scene.rotation[camera].T + scene.translation[camera]
        return np.array([project(scene.lens[camera], *point) for point in own])

    def _with_predicted(self, view: View, fits: np.ndarray, prediction: Prediction) -> np.ndarray:
        """Return ``fits`` and, if none of them continues the track, the poses by the lights where it expects its LEDs.

        The search keeps the poses with the most spots only, which may be those of a reflection.
        """
        if any(distance_square(fit, prediction) < _GATE_6 for fit in fits):
            return fits
        r = matrix_of(prediction.q_vt)
        spots, _ = self._solver.expected(view, r, prediction.t_v, prediction.covariance, _TRACK_REACH_PX)
        if (spots >= 0).sum() < 3:
            return fits
        return np.concatenate([fits, self._solver.from_start(view, r, prediction.t_v, spots)])

    def _apart(self, view: View, fits: np.ndarray, best: np.void) -> str:
        """Return OK, or a status if the two images do not belong together.

        Either the right image as a whole is shifted, or one camera sees a pattern of the LEDs where the best pose does
        not have it, or each image alone fits much better than both together.
        """
        if np.abs(best["shift"]).max() > _SHIFTED:
            return NOT_TOGETHER if abs(best["shift"][1]) > _SHIFTED else GEOMETRY_FILE
        own = (fits["spot"] >= 0).sum(axis=2)
        least = min(_OWN, len(self._solver.scene.leds) - 1)
        singles = []
        for c in range(2):
            here = (own[:, c] >= least) & (own[:, 1 - c] < _SECOND)  # a pattern in both is a second one
            more = np.flatnonzero(here & (own[:, c] >= (best["spot"][c] >= 0).sum() + _MORE))
            if len(more):
                singles.append((c, fits[more[np.argmax(fits["score"][more])]]))
        if not singles:
            if any(self._blind(view, best, c) for c in range(2)):
                return NOT_TOGETHER
            enough = int(best["points"]) >= np.minimum(view.counts, len(self._solver.scene.leds)).sum()
            return OK if enough and fits_within_budget(best) else self._each_alone(view, best)
        alone = dict(singles)
        for c in range(2):
            alone.setdefault(c, best)
        return self._why_apart(alone[0], alone[1])

    def _blind(self, view: View, best: np.void, camera: int) -> bool:
        """Return whether a camera sees lights, and hardly any where the best pose has LEDs in its view."""
        if view.counts[camera] < _LIGHTS or (best["spot"][camera] >= 0).sum() >= 2:
            return False
        lens = self._solver.scene.lens[camera]
        expected = sum(bool(in_image(lens, u, v, _EDGE_PX)) for u, v in self._projected(best, camera))
        return expected >= _LIGHTS

    def _why_apart(self, left: np.void, right: np.void) -> str:
        """Return the status for the poses of the left and of the right image alone that differ.

        Poses of a ring of another size, or of exchanged cameras, differ along the baseline only. Any other difference
        is one of time or of a camera's rotation.
        """
        scene = self._solver.scene
        baseline = (-scene.rotation[1].T @ scene.translation[1])[:2]
        off = (left["t"] - right["t"])[:2]  # of the position by the left image from that by the right one
        length = float(np.linalg.norm(baseline))
        along, across = float(baseline @ off) / length, abs(float(baseline[0] * off[1] - baseline[1] * off[0])) / length
        far = across * float(scene.lens[0]["fx"]) > _EPIPOLAR_PX * float(np.linalg.norm(left["t"]))
        return NOT_TOGETHER if far or across > abs(along) else GEOMETRY_FILE

    def _each_alone(self, view: View, both: np.void | None = None) -> str:
        """Return OK, or the status if each image alone shows a pattern of the LEDs, though both together do not.

        both: the pose of both together, if there is one: then each alone has to fit much better.
        """
        if min(view.counts) < _OWN:
            return OK
        singles = []
        for c in range(2):
            counts = np.zeros_like(view.counts)
            counts[c] = view.counts[c]
            fits, _ = self._solver.hypotheses(view._replace(counts=counts), level=_OWN)
            fits = fits[[bool((fit["spot"] >= 0).sum() >= _OWN and self._possible(fit)) for fit in fits]]
            if both is not None:  # a pattern of other lights does not count
                fits = fits[[shares_spots(fit, both) for fit in fits]]
            if not len(fits):
                return OK
            singles.append(fits[np.argmax(fits["score"])])
        if both is not None and apart_ratio(both, singles) < _APART:
            return OK
        return self._why_apart(singles[0], singles[1])

    def _by_spots(self, view: View, fits: np.ndarray) -> LedIdentification:
        scores = np.array([fit["score"] - self._marked_cost(view, fit) for fit in fits])
        order = np.argsort(scores)[::-1]
        best = fits[order[0]]
        rivals = [fits[k] for k in order[1:] if scores[k] > scores[order[0]] - self._settings.decisive]
        candidates = [best, *rivals]
        if any(not covers(best, rival) for rival in rivals) or not self._certain(view, best):
            return LedIdentification(AMBIGUOUS, candidates=candidates)
        if self._log_false_alarms(view, best, None) > math.log(self._settings.false_alarms):
            return LedIdentification(TOO_FEW, candidates=candidates)
        return LedIdentification(OK, best, candidates)

    def _by_track(self, view: View, fits: np.ndarray, prediction: Prediction) -> LedIdentification:
        squares = np.array([distance_square(fit, prediction) for fit in fits])
        inside = [k for k in range(len(fits)) if squares[k] < _GATE_6 and self._possible(fits[k])]
        if not inside:
            return LedIdentification(NO_MATCH)
        scores = {k: fits[k]["score"] - self._marked_cost(view, fits[k]) - 0.5 * squares[k] for k in inside}
        order = sorted(inside, key=lambda k: -scores[k])
        best = fits[order[0]]
        rivals = [fits[k] for k in order[1:] if scores[k] > scores[order[0]] - self._settings.decisive]
        candidates = [best, *rivals]
        if any(not covers(best, rival) for rival in rivals) or not self._certain(view, best):
            return LedIdentification(AMBIGUOUS, candidates=candidates, on_track=True)
        if self._log_false_alarms(view, best, prediction) > math.log(self._settings.false_alarms):
            return LedIdentification(TOO_FEW, candidates=candidates)
        return LedIdentification(OK, best, candidates)

    def _possible(self, fit: np.void) -> bool:
        """Return whether the target is in range, in front, facing the camera, and fits well for so few spots."""
        degrees = 2 * int(fit["points"]) - 6
        if 0 < degrees <= _FEW_DEGREES:  # too few to identify an outlier: one may be a stray light
            part = 2.0 / (9.0 * degrees)
            if fit["misfit"] > degrees * (1.0 - part + _FEW_SIGMA * math.sqrt(part)) ** 3:
                return False
        t = fit["t"]
        away = float(np.linalg.norm(t))
        facing = float(fit["r"][:, 2] @ t) / away
        near, far = self._settings.near_m, self._settings.far_m
        return near <= away <= far and t[2] > 0.0 and facing >= math.cos(math.radians(self._settings.steepest_deg))

    def _certain(self, view: View, fit: np.void) -> bool:
        """Return whether the covariance is valid: small attitude sigma, and chi-square is quadratic."""
        leds = self._solver.scene.leds
        flat = is_flat(leds[(fit["spot"][:, : len(leds)] >= 0).any(axis=0)])
        largest = self._settings.largest_sigma_deg[0 if flat else 1]
        return attitude_sigma_deg(fit) < largest and self._solver.is_linear(view, fit)

    def _marked_cost(self, view: View, fit: np.void) -> float:
        """Return the cost of a marked LED that is not the brightest, 0 if it is or is not in use."""
        if self._marked is None:
            return 0.0
        cost = 0.0
        for c in range(2):
            used = [n for n, k in enumerate(fit["spot"][c]) if k >= 0]
            if self._marked not in used or len(used) < 2:
                continue
            flux = {n: float(view.spots[c, fit["spot"][c, n]]["flux"]) for n in used}
            others = [value for n, value in flux.items() if n != self._marked]
            if max(others) > _BRIGHTER * flux[self._marked] or flux[self._marked] < _BRIGHTER * np.median(others):
                cost += _MARKED_COST
        return cost

    def _log_false_alarms(self, view: View, fit: np.void, prediction: Prediction | None) -> float:
        """Return ln of the expected number of such patterns made by stray lights at random (a contrario).

        Three spots of one camera give a pose; each further one must be at its projection. The density of stray lights
        is that of the unassigned ones near the pattern, at least half of one. The second camera's spots must be at the
        right position on their epipolar line. With a prediction the first three must be in its gates.
        """
        own = 0 if (fit["spot"][0] >= 0).sum() >= (fit["spot"][1] >= 0).sum() else 1
        used = [n for n, k in enumerate(fit["spot"][own]) if k >= 0]
        if len(used) < 3:
            return 0.0
        n_leds = len(self._solver.scene.leds)
        density = self._left_over(view, fit, own)
        odds = []
        for n in used:
            spot = view.spots[own, fit["spot"][own, n]]
            added = float(fit["floor"]) ** 2
            determinant = float((spot["noise_uu"] + added) * (spot["noise_vv"] + added) - spot["noise_uv"] ** 2)
            odds.append(math.log(min(1.0, density * 2.0 * math.pi * _GATE_2 * math.sqrt(determinant))))
        odds.sort()
        if prediction is None:
            tests = math.comb(int(view.counts[own]), 3) * n_leds * (n_leds - 1) * (n_leds - 2) * 4
            total = math.log(tests) + sum(odds[3:])
        else:
            gate = 2.0 * math.pi * _GATE_2 * self._gate_deviation(own, prediction)
            total = math.log(math.comb(n_leds, 3)) + 3.0 * math.log(min(1.0, density * gate)) + sum(odds[3:])
        other, window = 1 - own, self._disparity_window(fit)
        for k in fit["spot"][other]:
            if k < 0:
                continue
            spot = view.spots[other, k]
            sigma = math.sqrt(max(float(spot["noise_uu"]), float(spot["noise_vv"])) + self._slack)
            total += math.log(min(1.0, 2.0 * math.sqrt(2.0 * _GATE_2) * sigma / window))
        return total

    def _left_over(self, view: View, fit: np.void, camera: int) -> float:
        """Return the density of unassigned spots near the pattern, px^-2."""
        spots = view.spots[camera, : view.counts[camera]]
        used = [k for k in fit["spot"][camera] if k >= 0]
        centre_u, centre_v = float(spots["u"][used].mean()), float(spots["v"][used].mean())
        away = np.hypot(spots["u"] - centre_u, spots["v"] - centre_v)
        reach = 3.0 * max(float(away[used].max()), 3.0)
        left_over = int((away < reach).sum()) - len(used)
        lens = self._solver.scene.lens[camera]
        area = min(math.pi * reach * reach, float(lens["width"] * lens["height"]))
        return (left_over + 0.5) / area

    def _gate_deviation(self, camera: int, prediction: Prediction) -> float:
        """Return the root of the determinant of the covariance of the predicted image of the LEDs' centre, px^2."""
        scene = self._solver.scene
        away = float(np.linalg.norm(prediction.t_v))
        focal = float(scene.lens[camera]["fx"])
        across = prediction.covariance[:2, :2] * (focal / away) ** 2
        reach = float(np.abs(scene.leds).max()) * focal / away
        turn = float(np.trace(prediction.covariance[3:, 3:])) * reach * reach
        return math.sqrt(max(float(np.linalg.det(across + turn * np.eye(2))), 1e-6))

    def _disparity_window(self, fit: np.void) -> float:
        """Return the length of an epipolar line over which stray lights near the target's range are spread, px."""
        scene = self._solver.scene
        baseline = float(np.linalg.norm(scene.translation[1]))
        return 5.0 + 0.3 * float(scene.lens[1]["fx"]) * baseline / float(np.linalg.norm(fit["t"]))


def distance_square(fit: np.void, prediction: Prediction) -> float:
    """Return the squared Mahalanobis distance of a pose from a predicted one, six components."""
    d = np.empty(6)
    difference(fit["r"], fit["t"], matrix_of(prediction.q_vt), prediction.t_v, d)
    return float(d @ np.linalg.solve(prediction.covariance + fit["covariance"], d))


def apart_ratio(both: np.void, singles: Sequence[np.void]) -> float:
    """Return the ratio of variances (F) of what both images together add to the residuals of each alone, ``singles``.

    About 1 if the same errors cause both, such as a textured background; errors below those stated count as these.
    Infinite if each alone explains its spots within the budget, and both together explain fewer.
    """
    points = sum(int(fit["points"]) for fit in singles)
    if int(both["points"]) < points:
        return math.inf if all(fits_within_budget(fit) for fit in singles) else 0.0
    alone, degrees = sum(float(fit["misfit"]) for fit in singles), 2 * points - 6 * len(singles)
    added = 2 * int(both["points"]) - 6 - degrees
    return (float(both["misfit"]) - alone) / added / max(alone / degrees, 1.0)


def without_spots(view: View, fit: np.void) -> View:
    """Return ``view`` without the spots that ``fit`` uses."""
    spots, order, counts = view.spots.copy(), view.order.copy(), view.counts.copy()
    for c in range(2):
        rest = np.setdiff1d(np.arange(view.counts[c]), fit["spot"][c])
        counts[c] = len(rest)
        spots[c, : len(rest)], order[c, : len(rest)] = view.spots[c, rest], view.order[c, rest]
    return view._replace(spots=spots, counts=counts, order=order)


def shares_spots(fit: np.void, other: np.void) -> bool:
    """Return whether two poses have a spot in common."""
    return any(bool(np.isin(a[a >= 0], b).any()) for a, b in zip(fit["spot"], other["spot"], strict=True))


def covers(fit: np.void, rival: np.void) -> bool:
    """Return whether ``rival`` is within two sigmas of ``fit`` in every component, so that both are equivalent."""
    d = np.empty(6)
    difference(rival["r"], rival["t"], fit["r"], fit["t"], d)
    return bool((np.abs(d) < 2.0 * np.sqrt(np.diag(fit["covariance"]))).all())
