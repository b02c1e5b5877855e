"""The report on local sensitivities."""

from typing import Any

from tilth.analysis.sensitivity.local_answer import LocalQuestion, local_answer
from tilth.analysis.sensitivity.local_page import largest, local_report
from tilth.estimator.models.family import model_named
from tilth.estimator.models.parameters import TABLE_7_2

RELAXATION = model_named("relaxation")


def test_a_section_for_each_model_and_the_largest_first() -> None:
    question = LocalQuestion((RELAXATION, model_named("dynamic")), (4.5,), (3.0,))
    answer: Any = local_answer(TABLE_7_2, question)
    plain = {"machine": "a rig", "command": "tilth sensitivity", "another": {}, "curves": {}, "frequency": {}}
    report = local_report(answer | plain | {"made": {"machine_sha256": "0", "software": {}}})
    assert [section.id for section in report.sections][:3] == ["short", "relaxation-local", "dynamic-local"]
    of_model = answer["speeds"][0]["local"]
    order = [of_model[name]["overall"] for name in largest(of_model)]
    assert order == sorted(order, reverse=True)


def test_a_speed_at_which_it_is_unstable_is_refused_and_the_others_are_answered() -> None:
    oversteering = TABLE_7_2._replace(C_ar=0.2 * TABLE_7_2.C_ar)
    answer = local_answer(oversteering, LocalQuestion((RELAXATION,), (1.0, 20.0), (3.0, 3.0)))
    assert [entry["speed"] for entry in answer["speeds"]] == [1.0]
    assert [entry["speed"] for entry in answer["refused"]] == [20.0]
