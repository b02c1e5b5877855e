"""`tilth map`: what it says, and its exit status."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from soil_drives import driven, kept_season, one_soil

from tilth.cli import main
from tilth.cli.map import ENDINGS

pytest.importorskip("pyarrow")


@pytest.fixture(scope="module")
def season(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return kept_season(tmp_path_factory.mktemp("season"), {"rig": driven(one_soil, 0)[:8]})


@pytest.mark.parametrize("ending", ENDINGS)
def test_each_kind_of_map_is_written(
    ending: str, season: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / f"map{ending}"
    assert main(["map", str(season), "--out", str(out), "--cell", "20"]) == 0
    said = capsys.readouterr().err
    assert out.stat().st_size > 500 and "field 1: 8 stretches of 1 run" in said and f"wrote {out}" in said
    if ending == ".geojson":
        assert json.loads(out.read_bytes())["tilth"]["cell_m"] == 20.0


def test_of_several_fields_a_picture_is_of_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    near = driven(one_soil, 0)[:3]
    far = [replace(one, path_deg=one.path_deg + np.array([0.01, 0.0])) for one in near]
    season = kept_season(tmp_path / "season", {"rig": [*near, *far]})
    words = ["map", str(season), "--cell", "25", "--out"]
    assert main([*words, str(tmp_path / "map.png")]) == 2
    assert "there are 2: give --field" in capsys.readouterr().err
    assert main([*words, str(tmp_path / "map.png"), "--field", "2"]) == 0
    assert "field 2: 3 stretches" in capsys.readouterr().err
    assert main([*words, str(tmp_path / "map.geojson")]) == 0
    features = json.loads((tmp_path / "map.geojson").read_bytes())["features"]
    assert {one["properties"]["field"] for one in features} == {1, 2}


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["SEASON", "--out", "map.tif"], "ends in .geojson, .parquet, .png, .html"),
        (["SEASON", "--out", "there.png"], "never overwritten"),
        (["SEASON", "--out", "none/map.png"], "there is no such folder"),
        ([".", "--out", "map.png"], "no season in this folder"),
        (["SEASON", "--out", "map.png", "--machine", "other"], "there are: rig"),
        (["SEASON", "--out", "map.png", "--field", "2"], "--field 2: the fields are numbered 1 to 1"),
        (["SEASON", "--out", "map.png", "--cell", "0"], "give a number from 1 to 100 m"),
    ],
)
def test_wrong_use_is_one_sentence(
    words: list[str], said: str, season: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there.png").write_text("mine")
    line = ["map", *(str(season) if word == "SEASON" else word for word in words)]
    try:
        status = main(line)
    except SystemExit as ended:
        status = int(ended.code or 0)
    told = capsys.readouterr().err
    assert status == 2 and said in told and told.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["there.png"]
