"""A player's schedule: order, speed, pauses, jumps and the end, on a clock that is a number."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from logs import MACHINE, MACHINE_TEXT, SECOND
from recorded_run import START_NS, write_run

from tilth.logger.log.mcap_log import LogWriter, RunPart
from tilth.replay.player import PlayState, RunPlayer
from tilth.replay.recorded import Recorded, RecordedRun
from tilth.schemas.channels import CHANNEL
from tilth.schemas.flow import Event
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.notices import in_words

NOW_S = 1000.0  # of the clock when it begins


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RecordedRun]:
    one = RecordedRun(write_run(tmp_path_factory.mktemp("run"), 60.0, parts=2))
    yield one
    one.close()


@pytest.fixture
def player(run: RecordedRun) -> RunPlayer:
    one = RunPlayer(run)
    one.seek(0, NOW_S)
    return one


def seconds(rows: list[Recorded]) -> list[float]:
    return [row.at_ns / SECOND for row in rows]


def test_all_comes_once_and_in_order_each_at_its_time(run: RecordedRun, player: RunPlayer) -> None:
    player.play(NOW_S)
    heard: list[Recorded] = []
    for tick in range(610):
        now_s = NOW_S + 0.1 * tick
        rows = player.due(now_s)
        assert all(0 <= 0.1 * tick - at_s <= 0.1 + 1e-6 for at_s in seconds(rows))
        heard += rows
    assert heard == list(run.after(0)) and player.state == PlayState.ENDED
    assert player.at_ns(NOW_S + 1e6) == run.length_ns


@pytest.mark.parametrize("rate", [1.0, 7.5, 100.0])
def test_a_speed_is_times_real_time(player: RunPlayer, rate: float) -> None:
    player.set_rate(rate, NOW_S)
    player.play(NOW_S)
    rows = player.due(NOW_S + 20.0 / rate)
    assert seconds(rows)[-1] == pytest.approx(20.0, abs=0.101)
    assert player.at_ns(NOW_S + 20.0 / rate) == pytest.approx(20 * SECOND, abs=SECOND / 1000)


def test_another_speed_goes_on_from_where_it_is(player: RunPlayer) -> None:
    player.play(NOW_S)
    player.set_rate(10.0, NOW_S + 5.0)
    assert player.at_ns(NOW_S + 7.0) == pytest.approx(25 * SECOND, abs=100)
    for rate in (0.5, 101.0, float("nan")):
        with pytest.raises(ValueError, match="give 1 to 100 times real time"):
            player.set_rate(rate, NOW_S)
    assert player.rate == 10.0


def test_nothing_comes_while_it_is_paused(player: RunPlayer) -> None:
    player.play(NOW_S)
    assert player.due(NOW_S + 5.0)
    player.pause(NOW_S + 5.0)
    assert player.state == PlayState.PAUSED and player.due(NOW_S + 500.0) == []
    assert player.at_ns(NOW_S + 500.0) == 5 * SECOND
    player.play(NOW_S + 500.0)
    assert seconds(player.due(NOW_S + 501.0))[0] > 5.0
    assert player.at_ns(NOW_S + 501.0) == 6 * SECOND


def test_a_jump_lands_on_the_last_values_before_it(run: RecordedRun, player: RunPlayer) -> None:
    for at_s in (30.55, 10.0, 59.99, 0.0):
        state = player.seek(round(at_s * SECOND), NOW_S)
        assert state == run.before(round(at_s * SECOND)) and {row.topic for row in state} == {
            "/pose", "/soil_tire", "/status",
        }  # fmt: skip
        assert player.state == PlayState.PAUSED
        assert player.t_ns(NOW_S) == START_NS + round(at_s * SECOND)
    assert player.jumps == 5
    player.play(NOW_S)
    player.seek(45 * SECOND, NOW_S + 1.0)
    rows = player.due(NOW_S + 2.0)
    assert player.state == PlayState.PLAYING and 45.0 < seconds(rows)[0] <= seconds(rows)[-1] == 46.0


@pytest.mark.parametrize(("asked_s", "there_s"), [(-5.0, 0.0), (1e6, 60.0)])
def test_a_jump_stays_within_the_run(player: RunPlayer, asked_s: float, there_s: float) -> None:
    player.seek(round(asked_s * SECOND), NOW_S)
    assert player.at_ns(NOW_S) == there_s * SECOND


def test_at_its_end_it_stays_and_plays_again_from_the_beginning(player: RunPlayer) -> None:
    player.seek(55 * SECOND, NOW_S)
    player.play(NOW_S)
    player.due(NOW_S + 10.0)
    assert player.state == PlayState.ENDED and player.due(NOW_S + 20.0) == []
    player.pause(NOW_S + 21.0)
    assert player.state == PlayState.ENDED
    state = player.play(NOW_S + 30.0)
    assert seconds(state) == [0.0] * 3 and player.at_ns(NOW_S + 31.0) == SECOND
    player.due(NOW_S + 200.0)
    player.seek(10 * SECOND, NOW_S + 201.0)
    assert (player.state, player.at_ns(NOW_S + 300.0)) == (PlayState.PAUSED, 10 * SECOND)


def test_a_long_silence_is_not_waited_for(tmp_path: Path) -> None:
    path = tmp_path / "silent.mcap"
    writer = LogWriter(path, MachineFile(MACHINE, MACHINE_TEXT), RunPart("r", 1, START_NS))
    for t_s in (0, 1, 600, 601):
        event = Event(START_NS + t_s * SECOND, "mark", in_words(str(t_s)))
        writer.message("/event", event.t_ns, CHANNEL["/event"].encode(event))
    writer.close()
    run = RecordedRun([path])
    player = RunPlayer(run)
    player.seek(0, NOW_S)
    player.play(NOW_S)
    heard = [
        (round(0.1 * tick, 1), at_s) for tick in range(30) for at_s in seconds(player.due(NOW_S + 0.1 * tick))
    ]
    assert [at_s for _, at_s in heard] == [1.0, 600.0, 601.0]
    assert [now_s for now_s, _ in heard] == pytest.approx([1.0, 1.1, 2.1], abs=0.11)
    run.close()
