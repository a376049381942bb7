"""Two campaigns with the same cases, compared with paired intervals."""

import hil

narrow = hil.campaign("scheme-1", runs=10, overrides={"gnc.control.deadband_m": 0.004})
wide = hil.campaign("scheme-1", runs=10, overrides={"gnc.control.deadband_m": 0.008})
change = hil.compare(narrow, wide).difference["propellant_kg"]
print(f"{change['mean']:+.4f} kg ({change['low']:+.4f} .. {change['high']:+.4f})")
