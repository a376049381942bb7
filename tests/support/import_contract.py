"""Import contract of the parts, for lint-imports: which of them must not import which, by their declarations."""

from __future__ import annotations

from typing import Any

from grimp import ImportGraph
from importlinter import Contract, ContractCheck, fields, output

from tests.support.structure import ABOVE, part_of


class PartsContract(Contract):
    """Modules of ``importers`` import none of ``forbidden``: parts by their names, "core" among them."""

    importers = fields.SetField(subfield=fields.StringField())
    forbidden = fields.SetField(subfield=fields.StringField())

    def check(self, graph: ImportGraph, verbose: bool) -> ContractCheck:
        """Return the imports that break the contract, those inside functions included."""
        importers, forbidden = (set[str](each) for each in (self.importers, self.forbidden))  # type: ignore[call-overload]
        found = [
            f"{module} -> {imported}"
            for module in sorted(graph.modules)
            if part_of(module) in importers and module.startswith("hil.") and module != ABOVE
            for imported in sorted(graph.find_modules_directly_imported_by(module))
            if part_of(imported) in forbidden
        ]
        return ContractCheck(kept=not found, metadata={"imports": found})

    def render_broken_contract(self, check: Any) -> None:
        """Print the imports that break the contract."""
        for line in check.metadata["imports"]:
            output.print_error(line)
