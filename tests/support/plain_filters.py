"""Settings with which the filters are those of the bench paper: without error budget and commanded thrust."""

from __future__ import annotations

from typing import Final

BUDGET: Final = "gnc.navigation.budget"
WITHOUT_BUDGET: Final = (
    f"{BUDGET}.vision_bias_sigma_m=[0.0, 0.0, 0.0]",
    f"{BUDGET}.vision_misalignment_sigma_deg=0.0",
    f"{BUDGET}.vision_scale_sigma=0.0",
    f"{BUDGET}.vision_correlated_fraction=0.0",
    f"{BUDGET}.vision_noise_scale_sigma=0.0",
)
THRUST_OFF: Final = "gnc.navigation.thrust.enabled=false"
PLAIN: Final = (*WITHOUT_BUDGET, THRUST_OFF)
