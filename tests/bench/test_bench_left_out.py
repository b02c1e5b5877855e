"""The rigs of bench/left_out.py, and what it makes of written lines."""

import json
from pathlib import Path

import left_out
import pytest
import spatial_logs

from tilth.schemas.machine_toml import parse_machine
from tilth.schemas.plausible import doubts
from tilth.simulator.spatial.vehicle import check_tyres
from tilth.simulator.spatial_run import vehicle_in
from tilth.simulator.tractor import setting_of


@pytest.mark.parametrize("name", left_out.SIZES)
def test_each_size_is_a_rig_that_stands(name: str) -> None:
    source = spatial_logs.source_of(left_out.SIZES[name], 3)
    assert not doubts(parse_machine(source.machine_text))
    setting = setting_of(source.machine, source.seed, 1.0, source.scenario)
    check_tyres(vehicle_in(setting), source.scenario.spatial.step)


def test_lines_become_a_table(tmp_path: Path) -> None:
    file = tmp_path / "lines.jsonl"
    rows = [("nothing", 0.1, 0.1), ("camber thrust", 0.3, 0.1)]
    file.write_text(
        "".join(
            json.dumps({"size": "light", "seed": 0, "effect": name, "errors": [error] * 6, "sds": [sd] * 6})
            + "\n"
            for name, error, sd in rows
        )
    )
    found = left_out.outcomes([left_out.known(file)["light", 0]])
    assert list(found) == ["nothing", "camber thrust"]
    assert found["camber thrust"].moved == pytest.approx([0.2] * 6)
    assert (found["nothing"].holds, found["camber thrust"].holds) == (1.0, 0.0)
