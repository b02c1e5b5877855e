"""Plans as people write them: right ones are read, wrong ones are refused in one sentence that helps."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from logs import MACHINE_TEXT
from paths import ROOT

from tilth.estimator.models.manoeuvres import MANOEUVRES
from tilth.schemas.experiment import KINDS, ChirpRun, PlanError, edited, parse_plan, steered

TEXT = (ROOT / "examples/experiments.toml").read_text(encoding="utf-8")

WRONG = [
    ('kind = "chirp"', 'kind = "chrip"', ("run[2]", "chirp", "multisine")),
    ('kind = "chirp"', "", ("run[2]", "kind")),
    ("low_hz = 0.1", "low_Hz = 0.1", ("run[2].low_Hz", 'mean "low_hz"')),
    ("hold_s = 2.0", "hold = 2.0", ("run[1].hold", 'mean "hold_s"')),
    ("speed = 4.5", 'speed = "fast"', ("run[1].speed = 'fast': give a number (m/s)",)),
    ("speed = 4.5", "speed = 0.5", ("run[1].speed = 0.5", "1.5")),
    ("speed = 4.5", "speed = 16", ("run[1].speed = 16", "12 (m/s)")),
    ("speed = 4.5", 'speed = "16 km/h"', ("run[1].speed = '16 km/h'", "(m/s)")),
    ("amplitude_deg = 10", "amplitude_deg = 20", ("run[3].amplitude_deg = 20", "allows 12")),
    ("length = 400", "length = 40", ("field", "two headlands of 20 m", "40 m")),
    ("length = 400", "lenght = 400", ("field.lenght", 'mean "length"')),
    ("width = 80", "width = 80\ncorner = [42.0, -93.6]", ("field", "corner and heading_deg")),
    ("width = 80", "width = 80\ncorner = [142.0, -93.6]\nheading_deg = 0", ("corner", "90")),
    ("low_hz = 0.1", "low_hz = 0.9", ("run[2]", "high_hz = 0.5", "below low_hz")),
    ("low_hz = 0.06", "low_hz = 0.9", ("high_hz = 0.6", "below low_hz")),
    ("replicates = 3", "replicates = 2.5", ("run[1].replicates = 2.5: give a whole number",)),
    ("replicates = 3", 'replicates = "two"', ("run[1].replicates = 'two': give a whole number",)),
    ("replicates = 3", "replicates = []", ("run[1].replicates: give a whole number",)),
    ("speed = 4.5", "speed = nan", ("run[1].speed = nan: give a finite number (m/s)",)),
    ("replicates = 3", "replicates = 0", ("run[1].replicates = 0", "1")),
    ('side = "both"', 'side = "middle"', ("run[1].side", "right", "left")),
    ('machine = "jd7930-parker500"', "", ("machine: missing",)),
    ('name = "three-kinds"', 'name = "three kinds"', ("name = 'three kinds'",)),
    ("[field]", "[feild]", ("feild", 'mean "field"')),
    ("seconds = 15", "seconds = 15\npredicted = { C_xx = 0.1 }", ("predicted.C_xx", "sigma_i")),
    ("[[run]]", "[run]", ("not a TOML file", "write [[run]], in two brackets")),
    ("width = 80", "width = 80\nwidth = 90", ("not a TOML file", "for the second time")),
    ("width = 80", "width = 80\ncorner = [42.0]\nheading_deg = 0", ("field.corner[2]: missing (latitude,",)),
    ("length = 400", "", ("field.length: missing (m, along",)),
    ("replicates = 3", "replicates = true", ("run[1]: replicates = true: give a number",)),
    ("amplitude_deg = 10", "amplitude_deg = true", ("amplitude_deg = true: give a number",)),
    ("hold_s = 2.0", "hold_s = 25", ("run[1]: hold_s = 25 leaves no second side in seconds = 15",)),
    ('kind = "chirp"', 'kind = "chrip"', ("run[2].kind = 'chrip': did you mean \"chirp\"?",)),
    ('name = "three-kinds"', 'name = "three kinds"', ("give letters, digits, dots", "without spaces")),
    ("[[run]]", "[[run]", ("not a TOML file",)),
]


def test_the_example_is_read() -> None:
    plan = parse_plan(TEXT)
    assert [run.kind for run in plan.run] == ["steps", "chirp", "multisine"]
    assert isinstance(plan.run[1], ChirpRun)
    assert (plan.run[1].low_hz, plan.run[1].replicates, plan.limits.braking) == (0.1, 3, 1.5)


@pytest.mark.parametrize(("right", "wrong", "words"), WRONG)
def test_a_wrong_plan_says_where_and_what_is_allowed(right: str, wrong: str, words: tuple[str, ...]) -> None:
    assert right in TEXT
    with pytest.raises(PlanError) as refused:
        parse_plan(TEXT.replace(right, wrong, 1))
    said = str(refused.value)
    assert "\n" not in said
    for word in words:
        assert word in said


@pytest.mark.parametrize(
    ("old", "new", "other"),
    [
        ("speed = 4.5", "speed = 4.6", True),
        ("hold_s = 2.0", "hold_s = 2", False),
        ("hold_s = 2.0", "hold_s = 2.5", True),
        ("wheel_rate_degps = 15", "wheel_rate_degps = 20", True),
        ("length = 400", "length = 500", False),
        ("seed = 1", "seed = 2", False),  # nothing of these runs is drawn
        ("braking = 1.5", "braking = 1.2", False),
    ],
)
def test_a_plan_whose_steering_was_edited_is_told_from_one_that_was_not(
    old: str, new: str, other: bool
) -> None:
    told = f'predicted_for = "{steered(parse_plan(TEXT))}"\n'
    assert not edited(parse_plan(told + TEXT)) and not edited(parse_plan(TEXT))
    assert old in TEXT
    assert edited(parse_plan(told + TEXT.replace(old, new, 1))) == other


@pytest.mark.parametrize(
    ("text", "words"), [("", "nothing in it"), (MACHINE_TEXT, "this is a machine file; a plan needs")]
)
def test_what_is_another_file_is_told_as_that(text: str, words: str) -> None:
    with pytest.raises(PlanError, match=words):
        parse_plan(text)


def test_a_file_may_begin_as_some_editors_write_it() -> None:
    assert parse_plan("\ufeff" + TEXT) == parse_plan(TEXT)


@given(st.text(max_size=200))
def test_whatever_is_no_plan_is_refused(text: str) -> None:
    with pytest.raises(PlanError):
        parse_plan(text)


def test_a_field_as_on_the_command_line_is_told_to_be_a_section() -> None:
    before, after = TEXT[: TEXT.index("[limits]")], TEXT[TEXT.index("[[run]]") :]
    with pytest.raises(PlanError, match=r"field = '400x80': is a section: give \[field\] with its keys"):
        parse_plan(f'{before}field = "400x80"\n{after}')


def test_each_kind_is_a_manoeuvre() -> None:
    assert set(KINDS) <= {row.name for row in MANOEUVRES}
