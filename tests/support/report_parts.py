"""Made-up fits, predictions, tests of residuals and a frequency response, as a report takes them."""

from typing import Any

import numpy as np

from tilth.analysis.report.document import plain
from tilth.schemas.flow import PARAMETERS

VALUES = (220e3, 540e3, 170e3, 1.1, 1.5, 0.9)
WHY = "known only to -60 … +150 % (95 %): more steering is needed"


def parameters(share: float, factor: float = 1.0) -> Any:
    """All six, with so large an sd of the logarithm."""
    return {
        name: {"value": factor * value, "sd": factor * value * share, "status": "estimated", "reason": ""}
        for name, value in zip(PARAMETERS, VALUES, strict=True)
    }


def fit() -> Any:
    """Three segments, of which the last does not determine sigma_i, and all together."""
    kinds = ("step", "chirp", "row")
    runs: list[dict[str, Any]] = [
        {"id": f"s{k}", "log": 1, "start_s": 30.0 * k, "end_s": 30.0 * k + 28.0, "kind": kind, "name": "",
         "parameters": parameters(0.12, 1.0 + 0.05 * k), "nuisances": {}, "log_covariance": None,
         "seconds": 28.0}
        for k, kind in enumerate(kinds, 1)
    ]  # fmt: skip
    runs[2]["parameters"]["sigma_i"] = {"value": None, "sd": None, "status": "unestimated", "reason": WHY}
    covariance = 0.05**2 * (np.eye(6) + 0.3)
    agreement = {
        "chi2": 14.2,
        "dof": 11,
        "p": 0.22,
        "sentence": "The segments agree within their uncertainty.",
    }
    joint = {"parameters": parameters(0.05), "log_covariance": plain(covariance), "nuisances": {}}
    return {"runs": runs, "joint": joint, "agreement": agreement, "groups": []}


def held_out() -> Any:
    """Each subset predicts three drives."""
    runs = ("s1", "s2", "s3")
    return {
        "subsets": [
            {
                "fitted": list(fitted),
                "cells": [
                    {"run": run, "tractor_m": 0.4 + 0.01 * k, "implement_m": 0.3 + 0.01 * k,
                     "held_out": run not in fitted}
                    for k, run in enumerate(runs)
                ],
            }
            for fitted in (("s1",), ("s1", "s2"), runs)
        ]
    }  # fmt: skip


def residuals() -> Any:
    """One test passed, one failed, one undecided."""
    rows = (("r_t", "WhitenessTest", "passed", 0.3), ("r_t", "InputTest", "failed", 2e-4),
            ("r_i", "SizeTest", "undecided", None))  # fmt: skip
    return [
        {
            "output": output,
            "test": test,
            "outcome": outcome,
            "p_value": p,
            "sentence": f"{output}: {outcome}.",
        }
        for output, test, outcome, p in rows
    ]


def response(count: int = 30) -> Any:
    """Of two outputs; at the highest frequencies the gain may be zero."""
    hz = np.geomspace(0.05, 3.0, count)
    s = 2j * np.pi * hz
    value = np.stack([0.9 / (1 + 0.4 * s + 0.1 * s * s), 0.85 / (1 + 0.8 * s + 0.1 * s * s)], axis=1)
    half = np.minimum(0.1 + 0.3 * hz, np.pi)[:, None] * np.ones(2)
    low = np.where(hz[:, None] > 2.5, 0.0, 0.8 * abs(value))
    found: dict[str, Any] = plain({
        "outputs": ("r_t", "r_i"), "hz": hz, "excited": np.ones(count, bool), "value": value,
        "band": {"gain_low": low, "gain_high": 1.2 * abs(value), "phase_half": half},
        "coherence": np.clip(1.0 - 0.2 * hz[:, None] * np.ones(2), 0.0, 1.0),
        "curves": [{"name": name, "response": scale * value, "sentence": f"It fits, {name}."}
                   for name, scale in (("initial", 0.8), ("estimated", 1.0), ("previous", 0.9))],
        "speed": 4.5, "segments": 9, "segment_s": 12.0, "notes": ["Above 2 Hz little was excited."],
        "reason": "", "loop": {"sentence": "Nobody steered by the outputs."},
    })  # fmt: skip
    return found


def everything() -> Any:
    """All that may be plugged into a report beside its runs."""
    return {"fit": fit(), "held_out": held_out(), "residuals": residuals(), "response": response()}
