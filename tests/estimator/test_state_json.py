"""State as plain data and back, to the last bit."""

import json
from dataclasses import dataclass, field

import numpy as np
import pytest
from numpy.typing import NDArray

from tilth.estimator.diagnosis import open_numbers
from tilth.estimator.diagnosis.consistency import Consistency
from tilth.estimator.state_json import LONGEST_LIST, from_json_data, to_json_data


@dataclass
class Thing:
    array: NDArray[np.float64]
    pair: tuple[float, float, float] | None = None
    parts: list[NDArray[np.float64]] = field(default_factory=list)


SHAPES = ((0,), (3,), (4, 4), (17,), (50, 8), (0, 8), (2, 3, 4))


@pytest.mark.parametrize("shape", SHAPES)
def test_an_array_comes_back_to_the_bit(shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(4)
    array = rng.standard_normal(shape) * 10.0 ** rng.integers(-300, 300, shape)
    again = from_json_data(
        Thing, json.loads(json.dumps(to_json_data(Thing(array, (1.0, 2.0, 3.0), [array]))))
    )
    assert again.pair == (1.0, 2.0, 3.0)
    for found in (again.array, again.parts[0]):
        assert found.tobytes() == array.tobytes()
        assert found.shape == shape
        assert found.flags.writeable and found.dtype == np.float64


def test_columns_and_numbers_that_are_none_come_back() -> None:
    array = np.asfortranarray(np.arange(40.0).reshape(5, 8))
    array[0, 0], array[1, 1], array[2, 2] = np.nan, np.inf, -0.0
    again = from_json_data(Thing, json.loads(json.dumps(to_json_data(Thing(array)))))
    assert again.array.tobytes() == np.ascontiguousarray(array).tobytes()


def test_numbers_that_arithmetic_made_are_numbers() -> None:
    made = [np.bool_(True), np.int64(3), np.float64(0.1), np.float64(0.1) < 1.0]
    assert json.dumps(to_json_data(made)) == "[true, 3, 0.1, true]"


def test_long_arrays_are_short_text_and_lists_are_still_read() -> None:
    array = np.linspace(0.0, 1.0, 1000)
    data = to_json_data(Thing(array))
    assert len(json.dumps(data)) < 1000 * 8 * 4 / 3 + 200
    assert from_json_data(Thing, {**data, "array": array.tolist()}).array.tobytes() == array.tobytes()
    assert isinstance(to_json_data(np.zeros(LONGEST_LIST)), list)


@pytest.mark.parametrize(
    "spoilt", [{"shape": [7]}, {"base64": "AAA="}, {"base64": "%"}, {"base64": 5}, {"shape": ["x"]}]
)
def test_a_spoilt_array_is_refused(spoilt: dict[str, object]) -> None:
    data = to_json_data(Thing(np.zeros(20)))
    with pytest.raises(ValueError):
        from_json_data(Thing, {**data, "array": {**data["array"], **spoilt}})


def test_a_named_tuple_is_read_back_as_one() -> None:
    """What fits find of a file is one: as a list it ended the fold that took it up again."""
    n = len(open_numbers.NAMES)
    found = open_numbers.Misfit(
        1.5, np.arange(n) / 7, np.ones(n), np.ones(n + 1), np.ones(n + 1), np.ones((6, n + 1))
    )
    again = from_json_data(Consistency, json.loads(json.dumps(to_json_data(Consistency(fit=found))))).fit
    assert isinstance(again, open_numbers.Misfit) and again.total == 1.5
    assert all(np.array_equal(one, other) for one, other in zip(again[1:], found[1:], strict=True))
    assert again.by_name.shape == (n,)
    for data in ([1.5], "abcdef", {"total": 1.5}):
        with pytest.raises(ValueError, match="fit"):
            from_json_data(Consistency, to_json_data(Consistency()) | {"fit": data})
