"""Whatever the page says of its own, it says in German too."""

import json
import re
from html.parser import HTMLParser
from importlib import resources

import pytest

from tilth.schemas.sentences.soil import SoilWord

PAGE = resources.files("tilth.monitor") / "page"
SCRIPTS = sorted(file.name for file in PAGE.iterdir() if file.name.endswith(".js"))
TEMPLATE = re.compile(r"\bt`((?:[^`$]|\$\{[^`]*?\})*)`")
FILLED = re.compile(r"\$\{(?:[^{}]|\{[^{}]*\})*\}")
WHOLE = re.compile(r'\bword\("([^"]+)"\)|\bword\([^;]*?\? "([^"]+)" : "([^"]+)"\)')


def german() -> dict[str, str]:
    text = (PAGE / "german.js").read_text(encoding="utf-8")
    found: dict[str, str] = json.loads(text[text.index("{\n") :].rstrip().removesuffix(";"))
    return found


class _Said(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.texts: set[str] = set()

    def handle_data(self, data: str) -> None:
        if data.strip():
            self.texts.add(data.strip())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.texts.update(value for name, value in attrs if value and name in ("aria-label", "title"))


@pytest.mark.parametrize(("name", "least"), [("index.html", 80), ("setup.html", 50)])
def test_the_page_itself(name: str, least: int) -> None:
    said = _Said()
    said.feed((PAGE / name).read_text(encoding="utf-8"))
    assert len(said.texts) > least
    assert said.texts <= set(german()), said.texts - set(german())


@pytest.mark.parametrize("name", [name for name in SCRIPTS if name not in ("german.js", "language.js")])
def test_what_its_scripts_say(name: str) -> None:
    script = (PAGE / name).read_text(encoding="utf-8")
    said = {FILLED.sub("{}", found) for found in TEMPLATE.findall(script)}
    said |= {text for texts in WHOLE.findall(script) for text in texts if text}
    assert said <= set(german()), said - set(german())


def test_a_translation_fills_in_as_much() -> None:
    rows = german()
    assert all(english.count("{}") == row.count("{}") for english, row in rows.items())
    assert {str(word) for word in SoilWord} <= set(rows)
