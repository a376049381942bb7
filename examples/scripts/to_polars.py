"""A recording as a table of polars."""

import hil

run = hil.run("scheme-1", duration_s=20.0, record="recordings")
table = hil.open(run.summary["recording"]["file"]).to_polars()
print(table.select("t_s", "supervision.corridor_margin_m").describe())
