"""Smoothed turn rates found in what any log tells: headings and turn rates of one sender, no machine file."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from logs import START_NS
from paths import shared

from tilth.cli import main
from tilth.replay.readers.any_log import frames
from tilth.replay.turn_rates import TurnRates
from tilth.schemas.decode import Decoder, encode, frames_of
from tilth.schemas.flow import Frame

SOURCE = 52
SECONDS = 60.0


def compass(tau: float, seconds: float = SECONDS, gap_s: float = 0.0) -> list[Frame]:
    """Frames of a compass at 20 Hz on a weaving vehicle, its turn rate at 10 Hz through a first-order lag."""
    rng = np.random.default_rng(3)
    out: list[Frame] = []
    dt, held = 0.05, 0.0
    for k in range(round(seconds / dt)):
        t = k * dt
        rate = 0.25 * math.cos(0.35 * t) + 0.1 * math.cos(1.1 * t)
        heading = 1.0 + 0.25 / 0.35 * math.sin(0.35 * t) + 0.1 / 1.1 * math.sin(1.1 * t)
        held = rate if tau == 0.0 or k == 0 else held + (1.0 - math.exp(-dt / tau)) * (rate - held)
        collected = [(127250, {"heading_rad": (heading + rng.normal(0.0, 0.003)) % (2 * math.pi)})]
        if k % 2 == 0:
            collected.append((127251, {"yaw_rate_radps": held + rng.normal(0.0, 0.001)}))
        at_ns = START_NS + round((t + (gap_s if t > seconds / 2 else 0.0)) * 1e9)
        for pgn, values in collected:
            for can_id, data in frames_of(pgn, encode(pgn, values), SOURCE):
                out.append(Frame(at_ns, at_ns, "can0", can_id, True, False, data))
    return out


def found(rows: list[Frame]) -> TurnRates:
    decoder, rates = Decoder(), TurnRates()
    for row in rows:
        for message in decoder.messages(row):
            rates.take(message)
    return rates


@pytest.mark.parametrize("tau", [0.6, 2.6, 10.0])
@pytest.mark.parametrize("gap_s", [0.0, 7.0])
def test_a_time_constant_is_found(tau: float, gap_s: float) -> None:
    ((place, (lag, sd)),) = found(compass(tau, gap_s=gap_s)).smoothed().items()
    assert place == ("can0", SOURCE)
    assert abs(lag - tau) < max(4 * sd, 0.12 * tau) and sd < 0.2 * tau


@pytest.mark.parametrize("tau", [0.0, 0.1])
def test_what_is_not_smoothed_is_not_accused(tau: float) -> None:
    rates = found(compass(tau))
    assert not rates.smoothed() and not rates.sentences()


def test_straight_ahead_nothing_is_said() -> None:
    held_ns = {127250: 1.0, 127251: 0.0}
    rows = [
        Frame(at, at, "can0", can_id, True, False, data)
        for at in range(START_NS, START_NS + 30_000_000_000, 100_000_000)
        for pgn, value in held_ns.items()
        for can_id, data in frames_of(
            pgn, encode(pgn, {"heading_rad" if pgn == 127250 else "yaw_rate_radps": value}), SOURCE
        )
    ]
    assert not found(rows).smoothed()


def test_decode_and_discover_say_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "compass.log"
    log.write_text(
        "".join(f"({f.rx_ns * 1e-9:.6f}) can0 {f.can_id:08X}#{f.data.hex()}\n" for f in compass(2.6))
    )
    assert main(["decode", str(log)]) == 0
    err = capsys.readouterr().err
    assert f"address {SOURCE} on can0: its turn rate lags by 2.5" in err and "turn its smoothing off" in err
    assert main(["discover", str(log)]) == 0
    assert "its turn rate lags by 2.5" in capsys.readouterr().err  # the draft alone is the output
    assert main(["discover", str(log), "--json"]) == 0
    (source,) = json.loads(capsys.readouterr().out)["sources"]
    assert source["turn_rate_lag_s"]["value"] == pytest.approx(2.6, abs=0.2)


@pytest.mark.parametrize(
    "name",
    ["furuno-fap7011c-autopilot-maneuvers.raw", "susteranna-actisense-serial.raw", "candumpSample3.txt"],
)
def test_recordings_of_good_or_resting_sensors_accuse_nobody(name: str) -> None:
    assert not found(list(frames(shared(f"data/canboat/{name}")))).smoothed()
