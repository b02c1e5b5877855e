"""docs/codes.md: every code that is published or counted, with its words. `deploy/generate.py` writes it."""

import re
from collections.abc import Iterator, Mapping, Sequence
from inspect import signature
from typing import Final

from tilth.schemas.flow import FlagKind
from tilth.schemas.notices import NoticeCode
from tilth.schemas.reasons import Code
from tilth.schemas.sentences.diagnosis import DIAGNOSES
from tilth.schemas.sentences.notices import NOTICES, values_of
from tilth.schemas.sentences.reasons import SENTENCES
from tilth.schemas.sentences.rejections import REJECTIONS

TARGET: Final = "docs/codes.md"
_TEXTS: Final = {"flag": FlagKind.LOST.value, "quantity": "heading"}  # of which the words depend
_HEAD: Final = """# Codes

Written by `python -m tilth.deploy.generate` from [schemas/reasons.py](../schemas/reasons.py),
[schemas/notices.py](../schemas/notices.py), [schemas/rejections.py](../schemas/rejections.py) and
[schemas/sentences/](../schemas/sentences/). Programs decide by codes; the words are for people and may
change. `…` stands for a value. Kinds of events and flags of poses are in [notation.md](notation.md).
"""


class _Blank(float):
    def __format__(self, spec: str) -> str:
        return "…"


_REASONS: Final = """Why there is no number, or why it must not be used: `why` of a parameter, `chosen` of an
estimate. `of` and `numbers` are what stands for `…`; [schemas/reasons.py](../schemas/reasons.py) says what
they are."""
_NOTICES: Final = """What an event tells: its `notice`. A value that may be absent has a `?`."""
_REJECTIONS: Final = """Why frames, messages or measurements were not used: the keys of `rejected`. Readers of
logs have further ones ([logs.md](logs.md))."""


def text() -> str:
    """The page."""
    return (
        _HEAD
        + _table("Reasons", _REASONS, ("code", "words"), [*_rows(SENTENCES), *_diagnoses()])
        + _table("Notices", _NOTICES, ("code", "values", "words"), list(_notices()))
        + _table("Rejections", _REJECTIONS, ("code", "words"), _rows(REJECTIONS))
    )


def _rows(words: Mapping[Code, str] | Mapping[str, str]) -> list[Sequence[str]]:
    return [(f"`{code}`", _blank(template)) for code, template in sorted(words.items())]


def _diagnoses() -> list[Sequence[str]]:
    """Of the machine file and of what has been moved; their words are made of the numbers."""
    said = {code: words(("…",) * 3, (1.0,) * 4) for code, words in DIAGNOSES.items()}
    return [
        (f"`{code}`", re.sub(r"[-+]?\d+(\.\d+)?( ± \d+(\.\d+)?)?", "…", said[code])) for code in sorted(said)
    ]


def _blank(template: str) -> str:
    return re.sub(r"\{[^}]*\}", "…", template)


def _notices() -> Iterator[Sequence[str]]:
    for code in sorted(NoticeCode):
        words = NOTICES[code]
        if not isinstance(words, str):
            rows = signature(words).parameters.values()
            words = words(**{
                row.name: _TEXTS.get(row.name, "…") if row.annotation is str else _Blank(1.0) for row in rows
            })  # fmt: skip
        yield f"`{code}`", ", ".join(f"`{name}`" for name in values_of(code)), _blank(words)


def _table(title: str, told: str, heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [f"| {' | '.join(row)} |\n" for row in (heads, *rows)]
    lines.insert(1, f"|{'---|' * len(heads)}\n")
    return f"\n## {title}\n\n{told}\n\n" + "".join(lines)
