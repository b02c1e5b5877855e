"""Notices: every code has words, every one that is made has the values that its words need."""

import ast
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st
from paths import ROOT

from tilth.client.received import event_of
from tilth.deploy.imports import sources
from tilth.schemas.channels import CHANNEL, without_wording
from tilth.schemas.flow import Event, EventKind, FlagKind
from tilth.schemas.notices import OF_FOLD, Notice, NoticeCode, in_words, notice, reasoned
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.schemas.reasons import Code, Reason
from tilth.schemas.sentences import event_sentence, notice_sentence, sentence
from tilth.schemas.sentences import notices as words

ENCODING = "application/protobuf;tilth.Event"
TEXTS = {
    "bus": "can0", "flag": FlagKind.LOST, "of": "tractor_rear", "quantity": "heading",
    "mount": "tractor_rear", "identifier": "0x123", "parameter": "C_af",
}  # fmt: skip
"""Values that must be one of some texts; those of WORDS may be any; all others are numbers."""
WORDS = {
    "text",
    "why",
    "error",
    "file",
    "name",
    "run",
    "folder",
    "method",
    "methods",
    "what",
    "by",
    "ahead",
    "behind",
    "key",
    "line",
}


def value_of(name: str) -> float | str:
    return TEXTS.get(name, f"some {name}" if name in WORDS else 3.0)


def filled(code: NoticeCode, optional: bool = True) -> Notice:
    """With all that its words want."""
    names = [name for name in words.values_of(code) if optional or not name.endswith("?")]
    if code is NoticeCode.STRAY_FRAMES and optional:
        names.remove("identifier?")
    values = {name.rstrip("?"): value_of(name.rstrip("?")) for name in names}
    part = Notice(NoticeCode.ADDRESS, {"source": 28.0, "bus": "can0"})
    return Notice(code, values, (part, part), Reason(Code.NO_RTK))


@pytest.mark.parametrize("code", NoticeCode)
def test_every_code_has_words(code: NoticeCode) -> None:
    text = notice_sentence(filled(code))
    assert text and text == text.strip() and "{" not in text and not text.endswith(".")


def _made() -> Iterator[tuple[str, NoticeCode, set[str]]]:
    """Where the product makes notices: place, code, names of the values, where these stand there."""
    for module, source in sources().items():
        for node in ast.walk(ast.parse(source)):
            if not isinstance(node, ast.Call) or any(word.arg is None for word in node.keywords):
                continue
            called = ast.unparse(node.func)
            if called not in ("notice", "reasoned", "self._event"):
                continue
            names = {str(word.arg) for word in node.keywords}
            names |= {"bus"} if called == "self._event" else set()  # of logger.can.buses
            for part in (inner for one in node.args for inner in ast.walk(one)):
                if ast.unparse(part).startswith("NoticeCode.") and isinstance(part, ast.Attribute):
                    yield f"{module}:{node.lineno}", NoticeCode[part.attr], names


def test_every_notice_that_is_made_has_the_values_that_its_words_want() -> None:
    seen = set()
    for place, code, names in _made():
        wanted = words.values_of(code)
        assert {name for name in wanted if not name.endswith("?")} <= names, place
        assert names <= {name.rstrip("?") for name in wanted}, place
        seen.add(code)
    assert len(seen) > 0.8 * len(NoticeCode)


def test_the_codes_of_the_fold_are_those_that_it_makes() -> None:
    """A replay compares its events by them."""
    fold = {"tilth.estimator", "tilth.schemas.identity"}
    made = {
        code
        for module, source in sources().items()
        if f"tilth.{module}".startswith(tuple(fold)) and not module.startswith("estimator.calibration")
        for code in NoticeCode
        if f"NoticeCode.{code.name}" in source
    }
    by_kind = {NoticeCode.POSITIONS_REPEATED, NoticeCode.POSITIONS_SLOW, NoticeCode.REASON}
    parts = {NoticeCode.RECEIVER_AT, NoticeCode.ADDRESS, NoticeCode.FACTOR}
    assert (made | by_kind) - parts == OF_FOLD


def test_no_code_is_only_there_in_case() -> None:
    text = "".join(source for name, source in sources().items() if name != "schemas.notices")
    used = text.replace("schemas.sentences", "")
    unused = [code.name for code in NoticeCode if used.count(f"NoticeCode.{code.name}") < 2]
    kinds = {NoticeCode.POSITIONS_REPEATED.name, NoticeCode.POSITIONS_SLOW.name}  # by EventKind's value
    here = {NoticeCode.TEXT.name, NoticeCode.REASON.name}  # made in schemas.notices
    assert set(unused) <= kinds | here


@pytest.mark.parametrize("code", NoticeCode)
@pytest.mark.parametrize("optional", [True, False])
def test_what_is_published_is_heard_as_it_was(code: NoticeCode, optional: bool) -> None:
    if code is NoticeCode.STRAY_FRAMES and not optional:
        return  # one of its two senders is there
    event = Event(7, EventKind.LOG, filled(code, optional), 43.5, -83.4)
    data = CHANNEL["/event"].encode(event)
    assert event_of(data, ENCODING) == event
    assert pb.Event.FromString(data).text == event_sentence(event)


def test_a_place_is_told_but_of_words_of_others() -> None:
    found = Event(1, EventKind.SOIL_CHANGE, notice(NoticeCode.SOIL_CHANGING), 43.5, -83.25)
    assert event_sentence(found).endswith(" (at 43.500000, -83.250000)")
    assert event_sentence(Event(1, EventKind.MARK, in_words("stone"), 43.5, -83.25)) == "stone"


def test_an_event_of_an_old_log_and_one_of_a_later_version_are_heard_in_the_words_sent() -> None:
    old = pb.Event(t_ns=1, kind="gap", text="no frame for 12.0 s")
    later = pb.Event(t_ns=1, kind="gap", text="Funkstille")
    later.notice.code = "not_known_here"
    lacking = pb.Event(t_ns=1, kind="gap", text="Funkstille")
    lacking.notice.code = NoticeCode.SILENCE
    for sent in (old, later, lacking):
        heard = event_of(sent.SerializeToString(), ENCODING)
        assert heard.notice == in_words(sent.text) and event_sentence(heard) == sent.text


@given(st.text(), st.floats(), st.text())
def test_whatever_a_notice_holds_nothing_is_raised(code: str, number: float, text: str) -> None:
    sent = pb.Event(t_ns=1, kind="log", text="words")
    for part in (sent.notice, sent.notice.parts.add()):
        part.code = code if text else NoticeCode.STRAY_FRAMES
        part.values.add(name=text, number=number)
        part.values.add(name="frames", text=text)
        part.reason.code = code
    assert event_sentence(event_of(sent.SerializeToString(), ENCODING))


def test_other_words_are_the_same_event() -> None:
    event = Event(1, EventKind.GAP, notice(NoticeCode.SILENCE, silence_s=12.0))
    one, other = (pb.Event.FromString(CHANNEL["/event"].encode(event)) for _ in range(2))
    other.text = "Funkstille"
    assert one != other and without_wording(one) == without_wording(other)
    other.notice.values[0].number = 13.0
    assert without_wording(one) != without_wording(other)


def test_names_of_files_can_be_encoded() -> None:
    """They are bytes on a disk."""
    event = Event(1, EventKind.LOG, notice(NoticeCode.NEW_RUN, file="caf\udce9.mcap"))
    assert r"caf\udce9" in pb.Event.FromString(CHANNEL["/event"].encode(event)).text


def test_a_reason_is_told_in_its_words() -> None:
    assert notice_sentence(reasoned(Reason(Code.FIT_DROPPED))).startswith("a fit was not ready")


LEVER = Reason(
    Code.RECEIVER_MOVED, ("receiver.position", "implement_rear", "a drawbar"), (0.2, 0.1, 0.01, 0.01)
)
MOVED = sentence(LEVER)
ASKED = "It is not used: accept it as it is now (implement_rear or a drawbar), or put it back"
TYRES = Reason(Code.TYRES_CHANGED, ("tractor.wheel_speed_factor", "wheel_speed"), (1.0, 1.04, 0.005, 0.005))
CHANGED = sentence(TYRES)
FARTHER = Reason(Code.DRAWBAR_OFF, ("implement.d or tractor.c", "drawbar"), (-0.2, 0.02))
OTHER = "If another implement is hitched on than the file describes, choose it (`tilth implement`)."
OPPOSITE = Reason(Code.WHEEL_OPPOSITE, ("wheel_angle.sign",))


@pytest.mark.parametrize(
    ("told", "text"),
    [
        (reasoned(OPPOSITE, NoticeCode.CONTRADICTED),
         f"{sentence(OPPOSITE)} No number is given until this is over"),  # it ends with a "?"
        (reasoned(LEVER, NoticeCode.CONTRADICTED), f"{MOVED}. No number is given until this is over"),
        (reasoned(FARTHER, NoticeCode.CONTRADICTED),
         f"{sentence(FARTHER)} {OTHER} No number is given until this is over"),
        (reasoned(OPPOSITE, NoticeCode.FITS_AGAIN, key="wheel_angle.sign"),
         "wheel_angle.sign: over; the data fit the machine file again"),
        (reasoned(LEVER, NoticeCode.MOVED, ago_min=1.4), f"{MOVED}; 1 min ago. {ASKED}"),
        (reasoned(LEVER, NoticeCode.MOVED_EARLIER), f"an earlier run found: {MOVED}. {ASKED}"),
        (reasoned(LEVER, NoticeCode.MOVED_BACK, what="implement_rear"),
         "implement_rear is where it was before, and is used again"),
        (reasoned(TYRES, NoticeCode.TYRES_CHANGED),
         f"{CHANGED}. No estimate uses it; accept it as it is now (wheel_speed)"),
        (reasoned(TYRES, NoticeCode.TYRES_BACK, key="tractor.wheel_speed_factor"),
         "the tyres' radius is what it was before: tractor.wheel_speed_factor"),
        (reasoned(LEVER, NoticeCode.ACCEPTED, line="position = [1.0]"),
         f"accepted: {MOVED}; for the machine file: position = [1.0]"),
    ],
)  # fmt: skip
def test_what_a_diagnosis_tells(told: Notice, text: str) -> None:
    assert notice_sentence(told) == text


def test_kinds_are_listed() -> None:
    page = (ROOT / "docs" / "notation.md").read_text(encoding="utf-8")
    section = page.partition("## Kinds of events")[2].partition("\n## ")[0]
    assert all(f"`{kind}`" in section for kind in EventKind)
