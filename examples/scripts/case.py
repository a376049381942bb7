"""The worst case of a campaign, flown again and plotted."""

import hil

campaign = hil.campaign("scheme-1", runs=20, overrides={"dispersions": "stress"})
case = int(campaign.column("propellant_kg").argmax())
run = hil.run("scheme-1", case=case, dispersions="stress")
print(case, run.why()["text"])
run.plot().savefig("case.png")
