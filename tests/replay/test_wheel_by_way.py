"""The wheel angle is found among all messages, and its decoys are not taken for it."""

from collections.abc import Callable, Iterator

import numpy as np
import pytest
from logs import MACHINE, with_exact_lengths

from tilth.estimator.calibration.calibrate import TractorMotion, tractor_motion
from tilth.replay.wheel_by_way import WheelFound, WheelMessages, find, reading_as
from tilth.schemas.decode import Decoder, encode, frames_of
from tilth.schemas.flow import Frame, WheelAngle
from tilth.schemas.wheel_angle import RUDDER
from tilth.simulator.drive import drive
from tilth.simulator.scenario import parse_scenario
from tilth.simulator.tractor import Truth
from tilth.simulator.traffic import host_clock, traffic

OWN = MACHINE.wheel_angle.id
OTHER = 0x18FFA044  # of the message that is put in
DRIVE = parse_scenario("""
seconds = 150.0
speed = [[15.0, 2.5], [25.0, 1.5], [25.0, 1.5], [20.0, 1.5], [20.0, 1.5], [45.0, 4.2]]
steering = [[15.0, 0.0], [25.0, 15.0], [25.0, -15.0], [20.0, 25.0], [20.0, -25.0], [45.0, "random"]]
""")
Word = Callable[[Truth], np.ndarray]
Writer = Callable[[int], bytes]


@pytest.fixture(scope="module")
def truth() -> Truth:
    return drive(with_exact_lengths(MACHINE), 4, DRIVE.seconds, DRIVE)


@pytest.fixture(scope="module")
def frames(truth: Truth) -> list[Frame]:
    return list(traffic(MACHINE, truth))


@pytest.fixture(scope="module")
def motion(frames: list[Frame]) -> TractorMotion:
    decoder = Decoder(MACHINE)
    return tractor_motion(MACHINE, [m for frame in frames for m in decoder.measurements(frame)])


def _found(frames: list[Frame], more: list[Frame], motion: TractorMotion, without: bool = True) -> WheelFound:
    messages = WheelMessages()
    for frame in sorted([*frames, *more], key=lambda one: one.t_ns):
        if not (without and frame.can_id == OWN):
            messages.take(frame)
    return find(messages, motion, MACHINE.wheel_angle)


def _sent(
    truth: Truth, values: np.ndarray, write: Callable[[int], bytes], can_id: int = OTHER
) -> list[Frame]:
    at = host_clock(truth)
    rows = zip(truth.time[::5].tolist(), np.round(values[::5]).astype(int).tolist(), strict=True)
    return [Frame(at(t), at(t), "can0", can_id, True, False, write(value)) for t, value in rows]


def _noisy(truth: Truth) -> np.ndarray:
    angle = truth.wheel_angle + np.random.default_rng(1).normal(0.0, 1e-3, len(truth.time))
    return np.asarray(np.degrees(angle))


WRITERS: dict[str, tuple[float, float, Writer, tuple[int, str, int, bool]]] = {
    "signed, big": (
        100, 0, lambda v: b"\x01" + v.to_bytes(2, "big", signed=True) + b"\xff" * 5, (1, "big", 16, True),
    ),
    "signed, little, minus": (
        -50, 0, lambda v: b"\xff" * 3 + v.to_bytes(2, "little", signed=True) + b"\xff" * 3,
        (3, "little", 16, True),
    ),
    "offset": (128, 32000, lambda v: b"\xff" * 6 + v.to_bytes(2, "little"), (6, "little", 16, False)),
    "byte": (2, 125, lambda v: b"\xff" * 4 + bytes([v]) + b"\xff" * 3, (4, "little", 8, False)),
}  # fmt: skip


@pytest.mark.parametrize("kind", WRITERS)
def test_it_is_found_in_any_message(
    kind: str, truth: Truth, frames: list[Frame], motion: TractorMotion
) -> None:
    per_degree, offset, write, place = WRITERS[kind]
    sent = _sent(truth, per_degree * _noisy(truth) + offset, write)
    best = _found(frames, sent, motion).best
    assert best is not None and best.can_id == OTHER
    if best.bits == 8 or place[2] == 16:  # of a byte beside a constant one, a word reads the same
        assert (best.start_byte, best.byte_order, best.bits, best.signed) == place
    assert best.per_degree * (1 if best.bits == place[2] else 1 / 256) == pytest.approx(per_degree, rel=0.12)
    machine = reading_as(MACHINE, best)
    decoder, clock = Decoder(machine), host_clock(truth)
    read = [m.angle for f in sent for m in decoder.measurements(f) if isinstance(m, WheelAngle)]
    true = np.interp([f.t_ns for f in sent], [clock(t) for t in truth.time], truth.wheel_angle)
    assert np.corrcoef(read, true)[0, 1] > 0.995
    assert np.polyfit(true, read, 1)[0] == pytest.approx(1.0, abs=0.12)


def test_a_rudder_is_found(truth: Truth, frames: list[Frame], motion: TractorMotion) -> None:
    at = host_clock(truth)
    sent = []
    for t, angle in zip(truth.time[::10].tolist(), np.radians(_noisy(truth)[::10]).tolist(), strict=True):
        ((can_id, data),) = frames_of(RUDDER, encode(RUDDER, {"wheel_angle_rad": angle, "instance": 0}), 77)
        sent.append(Frame(at(t), at(t), "can0", can_id, True, False, data))
    best = _found(frames, sent, motion).best
    assert best is not None and best.rudder
    wheel = reading_as(MACHINE, best).wheel_angle
    assert (wheel.pgn, wheel.source, wheel.id, wheel.start_byte) == (RUDDER, 77, None, None)


def _lagging(values: np.ndarray, seconds: float) -> np.ndarray:
    return np.roll(values, round(seconds / 0.01))


def _curvature(truth: Truth) -> np.ndarray:
    return np.asarray(4e4 * truth.tractor.yaw_rate / np.maximum(truth.tractor.forward_velocity, 0.5))


DECOYS: dict[str, Word] = {
    "turn rate": lambda t: 5000 * t.tractor.yaw_rate,
    "curvature by the turn rate": _curvature,
    "the same, smoothed": lambda t: np.convolve(_curvature(t), np.ones(40) / 40, "same"),
    "speed": lambda t: 1000 * t.tractor.forward_velocity,
}


def _decoys(truth: Truth) -> Iterator[Frame]:
    def write(value: int) -> bytes:
        return value.to_bytes(2, "little", signed=True) + b"\xff" * 6

    for k, word in enumerate(DECOYS.values()):
        yield from _sent(truth, word(truth), write, OTHER + 256 * (k + 1))


def test_decoys_alone_are_not_it(truth: Truth, frames: list[Frame], motion: TractorMotion) -> None:
    found = _found(frames, list(_decoys(truth)), motion)
    assert found.best is None
    refused = {word.can_id: why for word, why in found.refused}
    assert "turn rate" in refused[OTHER + 256]
    assert "computed" in refused[OTHER + 512] and "computed" in refused[OTHER + 768]


def test_it_is_found_among_decoys(truth: Truth, frames: list[Frame], motion: TractorMotion) -> None:
    asked = _lagging(truth.wheel_angle, -0.3)  # what the steering is asked for: the wheels follow
    more = _sent(truth, 5000 * asked, lambda v: v.to_bytes(2, "big", signed=True) + b"\0" * 6, OTHER + 0x2000)
    found = _found(frames, [*_decoys(truth), *more], motion, without=False)
    assert found.best is not None and found.best.can_id == OWN
    assert [word.can_id for word in found.others] == [OTHER + 0x2000]
    assert "0x18FFC044" in found.sentences[0]


def test_of_equals_that_of_the_file_is_taken(
    truth: Truth, frames: list[Frame], motion: TractorMotion
) -> None:
    again = [
        Frame(f.t_ns, f.rx_ns, f.bus, OTHER, f.extended, f.error, f.data) for f in frames if f.can_id == OWN
    ]
    found = _found(frames, again, motion, without=False)
    assert found.best is not None and found.best.can_id == OWN
    assert reading_as(MACHINE, found.best).wheel_angle == MACHINE.wheel_angle


def test_a_drive_without_turns_tells_nothing(
    truth: Truth, frames: list[Frame], motion: TractorMotion
) -> None:
    short = [frame for frame in frames if frame.t_ns < frames[0].t_ns + 15_000_000_000]
    assert _found(short, [], motion, without=False).best is None
