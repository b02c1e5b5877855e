"""Messages as what JSON can hold, whatever their sender put into them."""

import math
from typing import Any, Final

from google.protobuf.message import Message

from tilth.client.received import text

LONGEST: Final = 64  # items of a list that are passed on


def plain(message: Message) -> dict[str, Any]:
    """Every field by its name: absent ones left out, what is no number None, texts short and in one line."""
    found: dict[str, Any] = {}
    for field in message.DESCRIPTOR.fields:
        value = getattr(message, field.name)
        if field.is_repeated:
            found[field.name] = [_one(item) for item in value[:LONGEST]]
        elif not field.has_presence or message.HasField(field.name):
            found[field.name] = _one(value)
    return found


def _one(value: Any) -> Any:
    if isinstance(value, Message):
        return plain(value)
    if isinstance(value, str):
        return text(value)
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
