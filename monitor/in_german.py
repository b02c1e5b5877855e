"""German beside the sender's English: a text whose code this version knows gets a neighbour `…_de`."""

from typing import Any

from tilth.client.received import Refused, estimate_of, event_of
from tilth.schemas.sentences import event_sentence, sentence
from tilth.schemas.sentences.german import GERMAN

Fields = dict[str, Any]


def add_german(kind: str, found: Fields, data: bytes, encoding: str) -> Fields:
    """found: the message as JSON, changed here. data, encoding: as it came. Raises Refused where an estimate
    is none."""
    if kind == "soil_tire":
        estimate = estimate_of(data, encoding)  # what is no estimate is refused as a controller would
        for row, parameter in zip(found["parameters"], estimate.parameters, strict=True):
            row["reason_de"] = sentence(parameter.reason, GERMAN)
        found["rule_de"] = sentence(estimate.rule, GERMAN)
    elif kind == "event":
        try:
            found["text_de"] = event_sentence(event_of(data, encoding), GERMAN)
        except Refused:
            return found  # it is shown as it came
    return found
