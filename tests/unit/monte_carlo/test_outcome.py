"""Row of a case: it has the declared columns and no others."""

from __future__ import annotations

from hil.config.load import load_rig, load_scenario
from hil.parts.campaigns.batch import Spec, run_batch
from hil.parts.campaigns.outcome import COUNTS, FLAGS, MARGINS, NUMBERS, TEXTS


def test_row_of_a_case_has_the_declared_columns() -> None:
    scenario = load_scenario("limit-cycle").value
    spec = Spec.of(scenario, load_rig("mock").value, 0, 1.0)
    (row,) = run_batch(spec, 0, 1)
    declared = {*FLAGS, *COUNTS, *TEXTS, *NUMBERS, *MARGINS}
    assert declared <= set(row)
    assert {name for name in row if name not in declared and "." not in name} == {"case", "seed"}
