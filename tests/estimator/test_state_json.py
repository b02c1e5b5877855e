"""State as plain data and back, to the last bit."""

import json
from dataclasses import astuple, dataclass, field

import numpy as np
import pytest
from numpy.typing import NDArray

from tilth.estimator.diagnosis.open_numbers import Misfit
from tilth.estimator.filters.soil_field import Told
from tilth.estimator.methods import rows
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


def test_what_rows_tell_of_the_file_comes_back_as_what_it_was() -> None:
    """Their fit goes through the log's text before it is used: a list in its place made the fold begin
    anew."""
    told = Misfit(3.0, np.ones(2), np.full(2, 0.5), np.ones(3), np.ones(3), np.ones((6, 20)))
    piece = rows.ToldPiece(1, 2, Told(np.eye(6), np.ones(6), np.zeros(6)))
    made = rows.Fit(
        np.zeros(6), np.eye(6), 0.9, 0.01, 120.0, 4, 1.0, False, False, None, None, told, (piece,)
    )
    back = from_json_data(rows.Fit, json.loads(json.dumps(to_json_data(made))))
    assert isinstance(back.of_file, Misfit)
    assert (back.pieces[0].begin_ns, back.pieces[0].end_ns) == (1, 2)
    np.testing.assert_array_equal(back.pieces[0].told.information, piece.told.information)
    for one, other in zip(astuple(back.of_file), astuple(told), strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_named_tuple_of_another_length_is_refused() -> None:
    with pytest.raises(ValueError):
        from_json_data(Misfit, [3.0])
