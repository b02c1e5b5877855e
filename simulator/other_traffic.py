"""The frames on the virtual tractor's bus that nobody here wants, such as an implement bus carries."""

from collections.abc import Iterator
from typing import Final

import numpy as np

from tilth.simulator.noise import OTHERS, Array, generator
from tilth.simulator.tractor import Truth

Sent = tuple[float, int, bool, bytes]
"""(s of UTC since the start at which it may go to the bus, identifier, 29-bit identifier?, data)"""

DEVICES: Final = {  # source address: NAME
    0x00: 0x0000000004211171,  # engine
    0x03: 0x0000030004211172,  # transmission
    0xF0: 0x2002800004211173,  # tractor ECU
    0x15: 0x00001D0006E11175,  # wheel-angle sensor
    0x26: 0xA0001D0004211176,  # virtual terminal
    0xF7: 0xA000820004211177,  # task controller
    0x2A: 0xA000840004211178,  # guidance display
    0x83: 0xA00C820005811179,  # implement ECU
}

# Identifier, frames/s, bytes: a constant, or c a counter, w slowly wandering, r random.
ROWS: Final = (
    (0x0CF00400, 50, "F0 7D 8A r w FF FF FF"),  # engine speed and torque
    (0x0CF00300, 20, "D1 w 2A FF FF FF FF FF"),
    (0x18FEF100, 10, "F7 w w 00 FF FF FF FF"),
    (0x18FEF200, 10, "r 02 FF FF FF FF FF FF"),
    (0x18FEEE00, 1, "w 50 FF FF FF FF FF FF"),
    (0x18FEEF00, 2, "FF FF FF w FF FF FF FF"),
    (0x18FEF500, 1, "C8 FF FF w 2F FF FF FF"),
    (0x18FEF600, 2, "FF w 60 FF FF FF FF FF"),
    (0x18FEF700, 1, "FF FF FF FF 1A 01 FF FF"),
    (0x18FECA00, 1, "00 FF 00 00 00 00 FF FF"),  # no active trouble code
    (0x18FEC100, 1, "c 1E 03 00 FF FF FF FF"),
    (0x18FEE500, 1, "5C 88 01 00 FF FF FF FF"),
    (0x0CF00203, 25, "CC r w FF FF FF FF FF"),  # transmission
    (0x18F00503, 10, "84 00 00 84 20 20 FF FF"),
    (0x18FFC203, 20, "01 c r r 00 00 FF FF"),
    (0x18FF5003, 20, "c r 7D r 7D FF FF FF"),
    (0x0CFE43F0, 10, "w 15 FF FF FF FF FF FF"),  # power take-off
    (0x0CFE45F0, 10, "w FF FF FF FF FF FF FF"),  # hitch
    *((0x0CFE10F0 + (valve << 8), 10, "7D FF 00 FF FF FF FF FF") for valve in range(6)),
    (0x18EF2AF0, 30, "21 c r r r 00 00 00"),  # proprietary, tractor ECU and display
    (0x18EFF02A, 20, "22 c r 00 00 00 00 00"),
    (0x0CADF02A, 10, "80 7D FC FF FF FF FF FF"),  # guidance command: not steering
    (0x18FFFF2A, 5, "77 r 80 00 FF FF FF FF"),  # the display's cross-track error
    (0x1CE6FF26, 1, "FE 26 83 01 00 00 FF FF"),  # virtual terminal
    (0x1CE68326, 20, "A8 r 00 c FF FF FF FF"),
    (0x1CE72683, 40, "A8 r 0B FF c 00 00 00"),
    (0x14CBFFF7, 1, "FE FF FF FF 01 00 00 00"),  # task controller
    (0x14CB83F7, 20, "03 00 01 00 r 00 00 00"),
    (0x14CBF783, 40, "03 r 8D 00 w 01 00 00"),
    (0x18FF2183, 10, "c 00 r r r r FF FF"),
)

BLOCK_S: Final = 10.0  # made at a time, so that an hour needs no more memory than a minute


def other_frames(truth: Truth) -> Iterator[Sent]:
    """All of ROWS until the end of the run, in the order of sending."""
    rng = generator(truth.seed, OTHERS)
    phases = rng.random(len(ROWS))
    end = float(truth.time[-1])
    for start in np.arange(0.0, end, BLOCK_S):
        block: list[Sent] = []
        for (can_id, rate, pattern), phase in zip(ROWS, phases, strict=True):
            stop = min(start + BLOCK_S, end)
            counts = np.arange(np.ceil(start * rate - phase), np.ceil(stop * rate - phase))
            late = rng.uniform(0.0, 0.2 / rate, len(counts))
            times = np.minimum((counts + phase) / rate + late, stop)
            data = _bytes(pattern, counts, rng)
            pieces = (data[8 * i : 8 * i + 8] for i in range(len(counts)))
            block += [(time, can_id, True, piece) for time, piece in zip(times.tolist(), pieces, strict=True)]
        block.sort()
        yield from block


def _bytes(pattern: str, counts: Array, rng: np.random.Generator) -> bytes:
    """8 bytes for each of the counts."""
    number = counts.astype(np.int64)
    data = np.empty((len(counts), 8), np.uint8)
    for i, token in enumerate(pattern.split()):
        if token == "c":
            data[:, i] = number & 0xFF
        elif token == "r":
            data[:, i] = rng.integers(0, 0xFB, len(counts))
        elif token == "w":
            data[:, i] = 0x60 + np.abs((number // 8) % 0x40 - 0x20)
        else:
            data[:, i] = int(token, 16)
    return data.tobytes()
