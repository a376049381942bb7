"""Check of the transfers of a plan, as they are planned from the states at which the phases before them end."""

from __future__ import annotations

import math

import numpy as np

from hil.config.load import Loaded
from hil.config.scenario import Scenario
from hil.core.messages import REFERENCE, new
from hil.errors import Problem
from hil.gnc import guidance
from hil.gnc.approach_monitor import closing_margin
from hil.gnc.guidance import GUIDANCE_STATE
from hil.gnc.guidance_transfer import least_drift_range, plan_transfer
from hil.params import gnc as gnc_params

_SAMPLES = 200  # of a transfer
_PAST_END_S = 1e-6


def check_transfers(scenario_file: Loaded[Scenario]) -> list[Problem]:
    """Return a problem if a transfer cannot be planned, is not passively safe as asked, or closes too fast."""
    scenario = scenario_file.value
    settings = scenario.gnc.guidance
    transfers = [name for name in settings.sequence if settings.phases[name].kind == "transfer"]
    if not transfers:
        return []
    key = f"gnc.guidance.phases.{transfers[0]}.kind"
    if scenario.target.motion == "tumble":
        text = '"transfer": the free motion is that of the Hill frame, allowed is another target.motion than "tumble"'
        return [Problem(scenario_file.where(key), key, text)]
    params, state = gnc_params.guidance(scenario), new(GUIDANCE_STATE)
    guidance.start(params, state)
    for phase, name in enumerate(settings.sequence):
        if name in transfers:
            key = f"gnc.guidance.phases.{name}.duration_s"
            text = _without_plan(params, state) if state.plan.n == 0 else _too_fast(scenario, params, state)
            if text:
                return [Problem(scenario_file.where(key), key, f"{settings.phases[name].duration_s:g}: {text}")]
        if phase < len(settings.sequence) - 1:
            end, go = float(state.ends_s), 1 if params.kind[phase] == guidance.WAIT else 0
            end = max(end, float(state.since_s)) if math.isfinite(end) else float(state.since_s)
            guidance.advance(params, state, end + _PAST_END_S, go, 0)
    return []


def _without_plan(params: np.record, state: np.record) -> str:
    """Return why the transfer that begins has no plan."""
    phase, plan = int(state.phase), state.plan
    plan_transfer(
        params.orbit, state.since_s, params.duration_s[phase], params.optimal[phase], params.acceleration[phase],
        plan.start.copy(), params.point[phase], state.work, plan,
    )  # fmt: skip
    if plan.n == 0:
        return (
            "no burns with acceleration_mps2 reach point_m in this time, allowed is another one, or impulses = "
            '"optimal": after half an orbit two impulses have no effect across the plane'
        )
    nearest = least_drift_range(params.orbit, plan, params.passive_s[phase], state.work.whole)
    return (
        f"the drift after a missed burn comes as near as {nearest:.2f} m within passively_safe_s, "
        f"allowed {params.clear_range:.2f} m by [keep_out]"
    )


def _too_fast(scenario: Scenario, params: np.record, state: np.record) -> str:
    """Return where the transfer closes faster than allowed, "" nowhere."""
    monitor, reference = gnc_params.approach_monitor(scenario), new(REFERENCE)
    for t_s in np.linspace(float(state.since_s), float(state.ends_s), _SAMPLES):
        guidance.reference(params, state, t_s, reference)
        margin = float(closing_margin(monitor, reference.r_CT_H, reference.v_CT_H))
        if margin <= 0.0:
            range_m = float(np.linalg.norm(reference.r_CT_H))
            return f"closes by {-margin:.3f} m/s faster at {range_m:.2f} m than gnc.corridor allows"
    return ""
