"""The JSON of estimates, the same from a replay and from the demo."""

from collections.abc import Mapping
from typing import TypedDict

from tilth.schemas.flow import PARAMETERS, Estimate
from tilth.schemas.sentences import sentence


class ParameterEntry(TypedDict):
    """N/rad or m; reason: why it is no estimate, in a sentence."""

    value: float | None
    sd: float | None
    status: str
    reason: str


class NuisanceEntry(TypedDict):
    """SI."""

    value: float
    sd: float


class EstimatesJson(TypedDict):
    """By method and name."""

    estimates: dict[str, dict[str, ParameterEntry]]
    nuisances: dict[str, dict[str, NuisanceEntry]]


def estimates_and_nuisances(estimates: Mapping[str, Estimate]) -> EstimatesJson:
    """Of each method."""
    return {
        "estimates": {method: _parameters(estimate) for method, estimate in estimates.items()},
        "nuisances": {
            method: {name: {"value": value, "sd": sd} for name, (value, sd) in estimate.nuisances.items()}
            for method, estimate in estimates.items()
        },
    }


def _parameters(estimate: Estimate) -> dict[str, ParameterEntry]:
    return {
        name: {"value": p.value, "sd": p.sd, "status": p.status.name.lower(), "reason": sentence(p.reason)}
        for name, p in zip(PARAMETERS, estimate.parameters, strict=True)
    }
