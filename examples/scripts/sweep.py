"""Sweep of the dead band: accepted cases and propellant along it."""

import hil

sweep = hil.sweep("scheme-1", "gnc.control.deadband_m", [0.002, 0.004, 0.008], runs=10)
for value, campaign in zip(sweep.values, sweep.campaigns, strict=True):
    print(value, campaign.accepted_rate["rate"], campaign.column("propellant_kg").mean())
sweep.figure().savefig("sweep.png")
