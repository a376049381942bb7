"""``hil.campaign`` and ``hil.run`` have what the options of the commands of that name have."""

from __future__ import annotations

import inspect
from dataclasses import fields
from typing import get_type_hints

import hil
from hil.api.runs import RunArguments, run
from hil.cli.run import StoredCaseOptions
from hil.parts.campaigns.api.campaign_request import CampaignRequest
from hil.parts.campaigns.api.campaigns import SharedArguments, StudyArguments, campaign, rare_event, sobol_indices
from hil.parts.campaigns.cli.campaign import CaseOptions, EngineOptions, StudyOptions, VariationOptions

NAMES = {"duration": "duration_s", "settings": "overrides"}
"""Option of the command -> argument."""


def arguments(function: object, more: type) -> set[str]:
    """Return the names of the arguments of ``function``, with those of the table ``more``."""
    return {*inspect.signature(function).parameters, *get_type_hints(more)}  # type: ignore[arg-type]


def options(*groups: type) -> set[str]:
    """Return the names of the options in ``groups``, as arguments."""
    return {NAMES.get(field.name, field.name) for group in groups for field in fields(group)}  # type: ignore[arg-type]


def test_campaign_has_every_option_of_the_command() -> None:
    wanted = options(CaseOptions, EngineOptions, StudyOptions, VariationOptions) | {"out"}
    assert wanted <= arguments(campaign, StudyArguments)


def test_run_has_the_options_of_a_case() -> None:
    assert options(StoredCaseOptions) <= arguments(run, RunArguments)


def test_studies_of_a_name_of_their_own_have_the_options_of_cases_and_workers() -> None:
    wanted = options(CaseOptions, EngineOptions) | {"out"}
    assert wanted <= arguments(rare_event, SharedArguments)
    assert wanted - {"runs"} <= arguments(sobol_indices, SharedArguments)


def test_signatures_show_every_option() -> None:
    assert {"case", "campaign", "dispersions", "navigation", "control"} <= {*inspect.signature(run).parameters}
    assert {"scheduler", "against", "rare", "sobol"} <= {*inspect.signature(campaign).parameters}
    assert not any(each.kind is each.VAR_KEYWORD for each in inspect.signature(run).parameters.values())


def test_signatures_show_the_defaults_of_the_options_that_the_request_has() -> None:
    request = {field.name: field.default for field in fields(CampaignRequest)}
    for name, parameter in inspect.signature(campaign).parameters.items():
        if name in request and name not in ("scenario", "out"):
            assert parameter.default == request[name] or parameter.default is None, name
    assert inspect.signature(hil.sweep).parameters["workers"].default == 0
