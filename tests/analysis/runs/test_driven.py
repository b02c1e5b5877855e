"""Blocks of driving are kept as they are; what is none is refused, not read."""

from pathlib import Path

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from logs import MACHINE

from tilth.analysis.runs.driven import DrivenBlock, load_blocks, store_blocks
from tilth.analysis.runs.kept import store_bytes

TIMES = st.integers(-(1 << 63), (1 << 63) - 1)
ANY = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)


@ANY
@given(blocks=st.lists(st.builds(DrivenBlock, TIMES, TIMES, st.binary())))
def test_blocks_come_back_as_they_were(tmp_path: Path, blocks: list[DrivenBlock]) -> None:
    store_blocks(tmp_path / "a.driving", blocks, MACHINE.log)
    assert load_blocks(tmp_path / "a.driving") == tuple(blocks)


@ANY
@given(told=st.binary(min_size=1, max_size=60))
def test_other_bytes_are_refused_or_hold_no_driving(tmp_path: Path, told: bytes) -> None:
    store_bytes(tmp_path / "b.driving", told, MACHINE.log)
    blocks = load_blocks(tmp_path / "b.driving")
    assert blocks is None or [block.driven() for block in blocks] == [None] * len(blocks)
