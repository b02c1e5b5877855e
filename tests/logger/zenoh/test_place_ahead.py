"""A controller asks about a place ahead: the client over real Zenoh, the answer of the fold."""

import math
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from loopback import PATIENCE_S, answers, rig, session, udp_bus

from tilth.client import Client, Staleness
from tilth.estimator import fold
from tilth.estimator.filters.soil_field import SOIL_FIELD, SoilWindow, Told
from tilth.estimator.methods import place
from tilth.logger.zenoh.place_ahead import KEY, PlaceAhead
from tilth.logger.zenoh.sink import ZenohSink
from tilth.schemas.flow import Status

BASE = "tilth/jd7930-parker500"


@pytest.fixture(scope="module")
def sink(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ZenohSink]:
    """Of a daemon that has learned of soft soil at 0, 0."""
    folder: Path = tmp_path_factory.mktemp("place")
    machine = rig(folder, udp_bus("can0", 1))[0]
    state = fold.initial(machine)
    state.diagnosis.consistency.confirmed = True
    state.time.latest_ns = 9_000_000_000
    memory = state.estimators[place.METHOD]
    memory.origin_deg, memory.informed_ns = (43.5, -83.4), 8_000_000_000
    path = np.zeros((SOIL_FIELD.points, 3, 2))
    information = 400.0 * np.eye(6)
    told = Told(information, information @ np.full(6, -0.4), np.zeros(6))
    memory.windows = [SoilWindow("pem", 0, 0, path, told)]
    answering = PlaceAhead(lambda x, y: fold.estimate_at(state, x, y))
    with closing(ZenohSink(machine, answers={KEY: answering.take})) as one:
        yield one


def test_the_client_is_told_what_is_known_of_a_place(sink: ZenohSink) -> None:
    with Client.connect(
        "jd7930-parker500", stale=Staleness(silence_s=3.0, data_s=math.inf), endpoint=sink.endpoints[0]
    ) as client:
        here, far = (client.estimate_at(x, 0.0, timeout_s=PATIENCE_S) for x in (0.0, 1000.0))
        assert here.method == far.method == "place" and here.of_place is not None and far.of_place is not None
        assert here.parameters[0].status is Status.ESTIMATED
        assert here.of_place.prior < far.of_place.prior
        assert far.of_place.latitude_deg - here.of_place.latitude_deg == pytest.approx(0.009, abs=1e-4)
        with pytest.raises(LookupError, match="give x and y of a place"):
            client.estimate_at(math.nan, 0.0, timeout_s=PATIENCE_S)
        with pytest.raises(LookupError, match="within 100 km"):
            client.estimate_at(1e9, 0.0, timeout_s=PATIENCE_S)


def test_a_question_on_a_wildcard_is_none(sink: ZenohSink) -> None:
    with session(sink.endpoints) as other:
        assert f"{BASE}/{KEY}" not in answers(other, f"{BASE}/soil_tire/**")
