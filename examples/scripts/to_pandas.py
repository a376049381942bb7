"""A recording as a table of pandas."""

import hil

run = hil.run("scheme-1", duration_s=20.0, record="recordings")
table = hil.open(run.summary["recording"]["file"]).to_pandas()
print(table[["truth.r_CT_H[0]", "navigation.r_CT_H[0]"]].describe(), table.attrs["units"]["truth.r_CT_H[0]"])
