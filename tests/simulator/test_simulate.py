"""What a simulation writes is read back; what is there is not overwritten. Whole runs: tests/cli."""

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tilth.replay.readers.any_log import frames
from tilth.schemas.flow import Frame
from tilth.simulator.packaged import packaged_file
from tilth.simulator.scenario import Scenario
from tilth.simulator.simulate import WRITERS, Candump, SimulationInput, files_of, simulate_to

US = st.integers(1, 1 << 51).map(lambda us: us * 1000)


@st.composite
def some_frame(draw: st.DrawFn) -> Frame:
    t_ns, extended = draw(US), draw(st.booleans())
    identifier = draw(st.integers(0, (1 << 29 if extended else 1 << 11) - 1))
    return Frame(t_ns, t_ns, "can0", identifier, extended, False, draw(st.binary(max_size=8)))


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(frame=some_frame())
def test_text_of_a_frame_is_read_back_to_the_microsecond(tmp_path: Path, frame: Frame) -> None:
    path = tmp_path / "x.log"
    path.unlink(missing_ok=True)
    writer = Candump(path)
    writer.frame(frame)
    writer.close()
    assert list(frames(path)) == [frame]


@pytest.mark.parametrize("ending", WRITERS)
@pytest.mark.parametrize("which", range(3))
def test_no_file_is_overwritten(tmp_path: Path, ending: str, which: int) -> None:
    log = tmp_path / f"x{ending}"
    there = files_of(log)[which]
    there.write_text("mine")
    source = SimulationInput(*packaged_file(), Scenario(), "", 1, 1.0)
    with pytest.raises(FileExistsError):
        simulate_to(source, log)
    assert [path.name for path in tmp_path.iterdir()] == [there.name] and there.read_text() == "mine"
