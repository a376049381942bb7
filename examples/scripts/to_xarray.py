"""A recording as a dataset of xarray: axes by name, units in the attributes."""

import hil

run = hil.run("scheme-1", duration_s=20.0, record="recordings")
data = hil.open(run.summary["recording"]["file"]).to_xarray()
print(data.truth_r_CT_H.sel(axis="x").sel(t_s=10.0, method="nearest").item(), data.truth_r_CT_H.attrs["units"])
