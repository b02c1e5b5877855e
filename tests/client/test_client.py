"""What a client makes of what it hears: refusals, staleness, covariance, the model, caution."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from client_daemon import LOG_SD, THETA, encoded, estimate
from hypothesis import given, settings
from hypothesis import strategies as st
from loopback import TEXT

from tilth.client import Cautious, Client, Limits, Staleness, linear
from tilth.client.latest import judge
from tilth.client.link import Alive, alive_of
from tilth.client.received import LARGEST, Refused, estimate_of, event_of, rig_of_message
from tilth.estimator.models import relaxation
from tilth.estimator.models.parameters import TABLE_5_1, rig_of
from tilth.schemas.channels import CHANNEL
from tilth.schemas.flow import PARAMETERS, Estimate, Event, ParameterEstimate, Status
from tilth.schemas.machine_toml import parse_machine
from tilth.schemas.notices import Notice, NoticeCode
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.schemas.reasons import Advice, AdviceKind, Code, Combination, Reason, text_reason
from tilth.schemas.sentences import event_sentence, sentence

ENCODING = "application/protobuf;tilth.SoilTireEstimate"
RULE = Staleness(silence_s=3.0, data_s=600.0)
LIMITS = Limits(ratio=2.0, per_s=0.1)
NOMINAL = np.array(THETA)
BOUNDED = settings(derandomize=True, max_examples=80, deadline=None)


def changed(**changes: Any) -> pb.SoilTireEstimate:
    """A message that is wrong in one thing: of C_ar, or of the whole."""
    message = pb.SoilTireEstimate.FromString(encoded(estimate()))
    for name, value in changes.items():
        if name == "log_covariance":
            message.log_covariance[:] = value
        elif name in ("t_ns", "method"):
            setattr(message, name, value)
        else:
            setattr(message.parameters[1], name, value)
    return message


def with_parameter(i: int, **changes: Any) -> Estimate:
    result = estimate()
    rows = list(result.parameters)
    rows[i] = replace(rows[i], **changes)
    return replace(result, parameters=tuple(rows))


def test_what_the_daemon_says_comes_whole() -> None:
    result = replace(
        estimate(7),
        bound=(0.1,) * 6,
        determined=(Combination((1.0, *[0.0] * 5), 0.1),),
        advice=Advice(AdviceKind.NOTHING_HELPS, ("C_ai",), (0.3,)),
        condition=3.0,
    )
    result = replace(
        result,
        nuisances={"bias": (0.1, 0.2)},
        excitation={"turns": 3.0},
        per_mass=(1.0,) * 3,
        per_mass_sd=(0.1,) * 3,
    )
    received = estimate_of(encoded(result), ENCODING)
    received = replace(received, per_mass=received.per_mass[:3], per_mass_sd=received.per_mass_sd[:3])
    assert received == result


def lopsided() -> list[float]:
    matrix = LOG_SD**2 * np.eye(6)
    matrix[0, 1] = LOG_SD**2
    return list(matrix.ravel())


INVALID: tuple[tuple[dict[str, Any], str], ...] = (
    ({"value": math.nan}, "its value is nan"),
    ({"value": math.inf}, "its value is inf"),
    ({"value": -1.0}, "a rig has 5000"),
    ({"sd": math.nan}, "its standard deviation is nan"),
    ({"sd": 0.0}, "its standard deviation is 0"),
    ({"age_s": -5.0}, "its age is -5"),
    ({"age_s": math.nan}, "its age is nan"),
    ({"status": 17}, "status 17 is not known here"),
    ({"log_covariance": []}, "a covariance of 0 numbers"),
    ({"log_covariance": [math.nan] * 36}, "no number"),
    ({"log_covariance": [0.0] * 36}, "it has no variance"),
    ({"log_covariance": list(-0.01 * np.eye(6).ravel())}, "a negative variance"),
    ({"log_covariance": lopsided()}, "not symmetric"),
)


@pytest.mark.parametrize(("changes", "words"), INVALID, ids=lambda v: str(v)[:40])
def test_a_number_that_cannot_be_is_invalid_and_says_why(changes: dict[str, Any], words: str) -> None:
    result = estimate_of(changed(**changes).SerializeToString(), ENCODING)
    assert result.parameters[1].status is Status.INVALID and words in sentence(result.parameters[1].reason)
    latest = judge(result, 0.1, RULE)
    assert not latest.usable[1] and words in latest.reason
    assert latest.theta(NOMINAL)[1] == NOMINAL[1]
    assert np.isfinite(latest.log_covariance(np.eye(6))).all()


@pytest.mark.parametrize(
    ("data", "encoding", "words"),
    [
        (b"\xff\xff", ENCODING, "not a SoilTireEstimate"),
        (b"", ENCODING, "nothing"),
        (bytes(LARGEST + 1), ENCODING, "too many"),
        (encoded(estimate()), "application/protobuf;tilth.Pose", "encoding"),
        (encoded(estimate()), "<script>alert(1)</script>" * 99, "encoding"),
        (changed(name="C_xx").SerializeToString(), ENCODING, "C_xx"),
        (changed(t_ns=0).SerializeToString(), ENCODING, "without a time"),
    ],
)
def test_what_is_not_an_estimate_is_refused_in_words(data: bytes, encoding: str, words: str) -> None:
    with pytest.raises(Refused, match=words) as caught:
        estimate_of(data, encoding)
    assert len(str(caught.value)) < 200


@BOUNDED
@given(st.binary(max_size=300))
def test_any_bytes_are_refused_or_of_no_use(data: bytes) -> None:
    for parse in (estimate_of, event_of, rig_of_message):
        names = {estimate_of: "SoilTireEstimate", event_of: "Event", rig_of_message: "Rig"}
        try:
            parse(data, f"application/protobuf;tilth.{names[parse]}")
        except Refused:
            continue
        assert parse is event_of  # two texts and a time: anything may be one


def test_fields_of_a_later_version_are_passed_over() -> None:
    later = encoded(estimate(7)) + bytes.fromhex("fa3e05") + b"later"  # field 1007, a text
    assert estimate_of(later, ENCODING) == estimate_of(encoded(estimate(7)), ENCODING)


def test_a_text_is_one_short_line() -> None:
    event = Event(1, "mark", Notice(NoticeCode.TEXT, {"text": "a\nb\x1b[31m" + "x" * 9999}))
    received = event_of(CHANNEL["/event"].encode(event), "application/protobuf;tilth.Event")
    words = event_sentence(received)
    assert words.startswith("a b [31mx") and len(words) == 500


def test_the_rig_comes_whole() -> None:
    machine = parse_machine(TEXT)
    received = rig_of_message(CHANNEL["/rig"].encode(machine), "application/protobuf;tilth.Rig")
    assert received.rig == rig_of(machine) and received.name == machine.name
    assert received.prior_log_sd == (0.7,) * 6
    assert [a.mount for a in received.antennas] == [r.mount for r in machine.receiver]
    assert [tuple(a[1:]) for a in received.antennas] == [r.position for r in machine.receiver]
    wrong = pb.Rig.FromString(CHANNEL["/rig"].encode(machine))
    wrong.m_t = -1.0
    with pytest.raises(Refused, match="m_t"):
        rig_of_message(wrong.SerializeToString(), "application/protobuf;tilth.Rig")


STALE = (  # age of it, of the data, rule for data, words
    (2.9, 10.0, 600.0, "", ""),
    (3.1, 10.0, 600.0, "silence", "no estimate for over 3 s"),
    (math.inf, 10.0, 600.0, "age_unknown", "how old it is cannot be known"),
    (2.0, 598.5, 600.0, "old_data", "data last informed it over 600 s ago"),  # both ages count
    (0.0, None, 600.0, "data_age_unknown", "does not say when"),
    (0.0, None, math.inf, "", ""),
    (0.0, 1e9, math.inf, "", ""),
)


@pytest.mark.parametrize(("age_s", "data_s", "allowed_s", "code", "words"), STALE)
def test_what_is_too_old(age_s: float, data_s: float | None, allowed_s: float, code: str, words: str) -> None:
    rule = Staleness(silence_s=3.0, data_s=allowed_s)
    latest = judge(with_parameter(2, age_s=data_s), age_s, rule)
    assert words in latest.refusals[2] and latest.usable[2] is (words == "") and latest.codes[2] == code
    assert latest.data_ages_s[2] == (math.inf if data_s is None else data_s + age_s)
    later = judge(with_parameter(2, age_s=data_s), age_s + 0.5, rule)  # ages grow, the reason stays
    assert not code or later.judged[2] == latest.judged[2]


def test_a_reason_of_the_daemon_keeps_its_code() -> None:
    told = with_parameter(1, status=Status.UNESTIMATED, reason=Reason(Code.WIDE, numbers=(0.9,)))
    latest = judge(estimate_of(encoded(told), ENCODING), 0.1, RULE)
    assert latest.codes == ("", "wide", "", "", "", "") and latest.refusals[1].startswith("unestimated: ")
    assert judge(None, math.inf, RULE).codes == ("nothing_heard",) * 6
    assert judge(None, math.inf, RULE, "only a simulation").codes == ("simulation_only",) * 6


def test_nothing_heard_is_of_no_use() -> None:
    latest = judge(None, 0.0, RULE)
    assert not any(latest.usable) and latest.age_s == math.inf and "nothing has been heard" in latest.reason
    assert (latest.theta(NOMINAL) == NOMINAL).all()
    assert (latest.log_covariance(0.5 * np.eye(6)) == 0.5 * np.eye(6)).all()


@pytest.mark.parametrize("status", [s for s in Status if s is not Status.ESTIMATED])
def test_only_an_estimated_one_is_used_with_its_block_of_the_covariance(status: Status) -> None:
    result = estimate_of(encoded(with_parameter(5, status=status, reason=text_reason("why"))), ENCODING)
    result = replace(result, log_covariance=tuple(0.01 * (np.eye(6) + 0.5).ravel()))
    latest = judge(result, 0.1, RULE)
    assert latest.reason == f"sigma_i: {status.name.lower()}: why"
    theta = latest.theta([1.0] * 6)
    assert theta[:5] == pytest.approx(THETA[:5]) and theta[5] == 1.0
    covariance = latest.log_covariance(0.49 * np.eye(6))
    assert covariance[0, 1] == pytest.approx(0.005) and covariance[5, 5] == 0.49
    assert not covariance[5, :5].any()
    with pytest.raises(ValueError, match="shape"):
        latest.log_covariance(np.eye(3))


@pytest.mark.parametrize("u", [4.5, 0.5, -1.0])
def test_the_linear_model_is_that_of_the_estimator(u: float) -> None:
    rig = TABLE_5_1._replace(**dict(zip(PARAMETERS, THETA, strict=True)))
    model = linear(TABLE_5_1, THETA, u)
    assert (relaxation.system_matrix(u, rig.geometry, rig.theta) == model.A).all()
    assert (relaxation.input_matrix(u, rig.geometry, rig.theta) == model.B).all()
    assert model.states == relaxation.STATES and model.inputs == relaxation.INPUTS
    assert linear(TABLE_5_1, THETA, u, "dynamic").A.shape == (6, 6)


@pytest.mark.parametrize(("u", "model"), [(math.nan, "relaxation"), (0.0, "dynamic"), (1.0, "magic")])
def test_where_a_model_does_not_hold(u: float, model: str) -> None:
    with pytest.raises(ValueError, match=r"hold|there is no model"):
        linear(TABLE_5_1, THETA, u, model)


WRONG: tuple[tuple[type, dict[str, Any]], ...] = (
    (Staleness, {"silence_s": 0.0, "data_s": 1.0}),
    (Staleness, {"silence_s": math.inf, "data_s": 1.0}),
    (Staleness, {"silence_s": 3.0, "data_s": math.nan}),
    (Limits, {"ratio": 0.5, "per_s": 0.1}),
    (Limits, {"ratio": 2.0, "per_s": 0.0}),
    (Limits, {"ratio": math.inf, "per_s": 0.1}),
    (Limits, {"ratio": 2.0, "per_s": 0.1, "log_sd": -1.0}),
)


@pytest.mark.parametrize(("kind", "values"), WRONG)
def test_a_rule_that_makes_no_sense_is_refused(kind: type, values: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=r" = .*: give "):
        kind(**values)


def test_a_rule_must_be_chosen() -> None:
    with pytest.raises(TypeError, match="stale"):
        Client.connect("jd7930-parker500")  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="data_s"):
        Staleness(silence_s=3.0)  # type: ignore[call-arg]


@pytest.mark.parametrize("name", ["", "a/replay", "*", "**", "a b", "$", "a/../b"])
def test_a_machine_is_one_part_of_a_key(name: str) -> None:
    with pytest.raises(ValueError, match="machine file"):
        Client.connect(name, stale=RULE)


@pytest.mark.parametrize(
    ("token", "whose"),
    [
        ("farm/7/tilth/rig/alive", Alive(False, "rig")),
        ("farm/7/tilth/rig/replay/alive", Alive(True, "rig")),
        ("farm/7/tilth/replay/alive", Alive(False, "replay")),
        ("farm/7/tilth/rig/other/alive", None),
        ("farm/7/tilth/rig/replay/replay/alive", None),
        ("farm/7/tilth/alive", None),
        ("farm/7/tilth/a b/alive", None),
        ("farm/7/tilth/@x/alive", None),
    ],
)
def test_a_token_says_who_lives(token: str, whose: Alive | None) -> None:
    assert alive_of(token, "farm/7/tilth") == whose


def test_a_simulation_comes_after_what_drives() -> None:
    assert sorted([Alive(True, "a"), Alive(False, "z")]) == [Alive(False, "z"), Alive(True, "a")]


@pytest.mark.parametrize("prefix", ["", "a//b", "**", "a/*", "/a"])
def test_a_prefix_has_no_wildcards(prefix: str) -> None:
    with pytest.raises(ValueError, match="machine file"):
        Client.connect("a", stale=RULE, prefix=prefix)


def follow(cautious: Cautious, result: Estimate | None, seconds: float, age_s: float = 0.1) -> list[Any]:
    return [cautious.step(judge(result, age_s, RULE), 0.1 * i) for i in range(round(seconds * 10) + 1)]


def test_parameters_in_force_begin_at_nominal_and_move_at_the_rate() -> None:
    cautious = Cautious(NOMINAL, LIMITS)
    steps = follow(cautious, estimate(scale=1.5), 10.0)
    assert steps[0].theta == pytest.approx(NOMINAL)
    logs = np.log([step.theta for step in steps])
    assert np.abs(np.diff(logs, axis=0)).max() <= 0.01 + 1e-12
    assert steps[-1].theta == pytest.approx(1.5 * NOMINAL) and steps[-1].notes == ("",) * 6
    assert steps[1].notes == ("moving at the rate limit",) * 6


def test_a_gap_in_calls_is_no_leave_to_jump_further_than_the_rate_allows() -> None:
    cautious = Cautious(NOMINAL, LIMITS)
    latest = judge(estimate(scale=1.9), 0.1, RULE)
    cautious.step(latest, 0.0)
    assert cautious.step(latest, 1.0).theta == pytest.approx(NOMINAL * math.exp(0.1))
    assert cautious.step(latest, 0.5).theta == pytest.approx(NOMINAL * math.exp(0.1))  # time ran back


@pytest.mark.parametrize("scale", [10.0, 0.03])
def test_bounds_hold_and_say_so(scale: float) -> None:
    rows = [replace(row, value=row.value * scale) for row in estimate().parameters[:3] if row.value]
    result = replace(estimate(), parameters=(*rows, *estimate().parameters[3:]))
    last = follow(Cautious(NOMINAL, LIMITS), result, 10.0)[-1]
    bound = 2.0 if scale > 1 else 0.5
    assert last.theta[:3] == pytest.approx(bound * NOMINAL[:3])
    assert all("beyond the bounds of nominal" in note for note in last.notes[:3])
    assert last.theta[3:] == pytest.approx(NOMINAL[3:])


def test_what_may_not_be_used_goes_back_to_nominal_smoothly() -> None:
    cautious = Cautious(NOMINAL, LIMITS)
    reached = follow(cautious, estimate(scale=1.5), 10.0)[-1].theta
    back = [cautious.step(judge(estimate(scale=1.5), 4.0, RULE), 10.0 + 0.1 * i) for i in range(60)]
    assert back[0].theta == pytest.approx(reached, rel=0.011)
    assert back[-1].theta == pytest.approx(NOMINAL)
    assert "no estimate for over 3 s" in back[-1].notes[0]


def test_uncertain_ones_are_not_followed() -> None:
    result = replace(estimate(scale=1.5), log_covariance=tuple((0.09 * np.eye(6)).ravel()))
    last = follow(Cautious(NOMINAL, replace(LIMITS, log_sd=0.25)), result, 10.0)[-1]
    assert last.theta == pytest.approx(NOMINAL) and last.notes[0] == "too uncertain: 30% where 25% is allowed"


def test_frozen_means_frozen_and_thaws_at_the_rate() -> None:
    cautious = Cautious(NOMINAL, LIMITS)
    follow(cautious, estimate(scale=1.2), 3.0)
    cautious.frozen = True
    held = [cautious.step(judge(None, 0.0, RULE), 3.0 + i) for i in range(9)]
    assert all(step.theta == pytest.approx(1.2 * NOMINAL) and step.notes[0] == "frozen" for step in held)
    cautious.frozen = False
    assert cautious.step(judge(None, 0.0, RULE), 11.1).theta == pytest.approx(1.2 * NOMINAL * math.exp(-0.01))


def test_a_shadow_watches_and_touches_nothing() -> None:
    steps = follow(Cautious(NOMINAL, replace(LIMITS, shadow=True)), estimate(scale=1.5), 9.0)
    assert all(step.theta == pytest.approx(NOMINAL) for step in steps)
    assert steps[-1].wanted == pytest.approx(1.5 * NOMINAL)
    assert steps[-1].notes == ("shadow: nominal is in force",) * 6


@pytest.mark.parametrize("nominal", [[1.0] * 5, [0.0] * 6, [math.nan] * 6])
def test_nominal_is_six_numbers_above_zero(nominal: list[float]) -> None:
    with pytest.raises(ValueError, match="six numbers"):
        Cautious(nominal, LIMITS)


@BOUNDED
@given(
    st.lists(
        st.tuples(
            st.sampled_from(list(Status)),
            st.floats(5e3, 3e6),
            st.floats(0.0, 5.0),
            st.floats(0.0, 3.0),
            st.booleans(),
        ),
        max_size=30,
    )
)
def test_whatever_comes_what_is_in_force_is_bounded_and_moves_slowly(
    steps: list[tuple[Status, float, float, float, bool]],
) -> None:
    cautious, t_s, before = Cautious(NOMINAL, LIMITS), 0.0, NOMINAL
    for status, value, age_s, elapsed_s, frozen in steps:
        t_s += elapsed_s
        cautious.frozen = frozen
        row = ParameterEstimate(value, value * LOG_SD, status, text_reason("why"), 0.0)
        result = replace(estimate(), parameters=(row, *estimate().parameters[1:]))
        theta = cautious.step(judge(result, age_s, RULE), t_s).theta
        assert (np.abs(np.log(theta / NOMINAL)) <= math.log(2.0) + 1e-9).all()
        assert (np.abs(np.log(theta / before)) <= 0.1 * elapsed_s + 1e-9).all()
        before = theta
