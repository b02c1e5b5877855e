"""The JSON of estimates, the same from a replay and from the demo."""

from collections.abc import Mapping

from tilth.schemas.flow import PARAMETERS, Estimate
from tilth.schemas.sentences import sentence


def estimates_and_nuisances(estimates: Mapping[str, Estimate]) -> dict[str, object]:
    """{"estimates": {method: {parameter: …}}, "nuisances": {method: {name: …}}}; N/rad, m, SI."""
    return {
        "estimates": {method: _parameters(estimate) for method, estimate in estimates.items()},
        "nuisances": {
            method: {name: {"value": value, "sd": sd} for name, (value, sd) in estimate.nuisances.items()}
            for method, estimate in estimates.items()
        },
    }


def _parameters(estimate: Estimate) -> dict[str, object]:
    return {
        name: {"value": p.value, "sd": p.sd, "status": p.status.name.lower(), "reason": sentence(p.reason)}
        for name, p in zip(PARAMETERS, estimate.parameters, strict=True)
    }
