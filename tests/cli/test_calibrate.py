"""`tilth calibrate` from a log: numbers within their sds, files kept."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from calibrated_drive import DRIVE, simulated_drive
from logs import MACHINE, MACHINE_FILE, MACHINE_TEXT
from paths import ROOT, shared_files

from tilth.analysis.calibration.machine_text import rewritten
from tilth.cli import main
from tilth.estimator.calibration.calibrate import _Looked
from tilth.estimator.calibration.calibrate import _looked as _look_at
from tilth.estimator.calibration.changes import Changes, applied
from tilth.estimator.calibration.drive import MOUNTS
from tilth.estimator.calibration.steering_response import NEVER_STEERED
from tilth.replay.readers.any_log import frames
from tilth.schemas.decode import Decoder
from tilth.schemas.flow import Measurement
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import parse_machine

pytestmark = pytest.mark.long


PICTURE = ROOT / "docs/pictures/page-demo.png"
BAD = Changes(
    delay=np.full(4, 0.05), forward=np.array([0.15, -0.1]), lateral_offset=np.array([0.1, 0.1]),
    pair=np.radians([-2.0, 2.0]), hitch=np.array([0.15, -0.1]), wheel_zero=np.radians(3.0), wheel_gain=1.1,
    wheel_sign=-1, assignment=(1, 0, 2, 3),
)  # fmt: skip
WRONG = rewritten(
    MACHINE_TEXT, MACHINE, applied(MACHINE, BAD),
    {MOUNTS[device].value: MOUNTS[k].value for k, device in enumerate(BAD.assignment)}, "by hand",
)  # fmt: skip


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulated_drive(tmp_path_factory.mktemp("drive"), DRIVE)


def _true(drive: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(Path(f"{drive}.truth.json").read_text(encoding="utf-8"))
    return found


def test_a_wrong_file_becomes_right(drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Everything at once: a file that is wrong in all that people get wrong, and in its structure."""
    out, report = tmp_path / "m.toml", tmp_path / "report.html"
    (tmp_path / "real.toml").write_text(WRONG, encoding="utf-8")
    out.symlink_to(tmp_path / "real.toml")
    report.write_text("of last year", encoding="utf-8")
    arguments = [str(drive), "--machine", str(out), "--out", str(out), "--report", str(report)]
    assert main(["calibrate", *arguments, "--yes", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert "refused" not in told  # which says why there are no numbers
    assert sorted(fault["kind"] for fault in told["faults"]) == ["reversed_pair", "wheel_sign"]
    numbers = {number["name"]: number for number in told["numbers"]}
    sd = {name: number["sd"] for name, number in numbers.items()}
    now, truth = parse_machine(out.read_text(encoding="utf-8")), _true(drive)
    rig, nuisances = truth["rig"], truth["nuisances"]
    away = rig["b"]["value"] - MACHINE.tractor.b.value
    assert now.tractor.c.value == pytest.approx(rig["c"]["value"] - away, abs=3 * sd["c"])
    zero = np.degrees(nuisances["wheel_zero"])
    assert now.wheel_angle.zero.value == pytest.approx(zero, abs=3 * np.degrees(sd["wheel_zero"]))
    assert now.wheel_angle.scale * now.wheel_angle.sign == pytest.approx(0.01, rel=3 * sd["wheel_gain"])
    delay = np.mean([nuisances[f"latency_{mount.value}"] for mount in MOUNTS])
    assert np.mean([r.latency.value for r in now.receiver]) == pytest.approx(delay, abs=3 * sd["latency"])
    assert [r.mount for r in now.receiver if r.name == MACHINE.receiver[0].name] == [
        MACHINE.receiver[0].mount
    ]
    # The linkage's curvature shows less, and what the front wheels do least: this plant has one slip angle an
    # axle, on which it has no part.
    shares = {n["name"]: n["sd"] / n["prior_sd"] for n in told["numbers"]}
    most = {"wheel_curve": 0.5, "ackermann": 0.8}
    assert {name: share for name, share in shares.items() if share >= most.get(name, 0.25)} == {}
    assert now.tractor.ackermann.value == pytest.approx(1.0, abs=3 * sd["ackermann"])
    assert out.is_symlink() and out.read_text(encoding="utf-8") == told["machine_file"]
    (kept,) = tmp_path.glob("m.toml.before-1")
    assert kept.read_text(encoding="utf-8") == WRONG
    assert (tmp_path / "report.html.before-1").read_text(encoding="utf-8") == "of last year"
    senders = {one["mount"]: one for one in told["receivers"]}
    for receiver in now.receiver:
        sender = senders[receiver.mount.value]
        assert sender["name"] == f"{receiver.name:016X}" and sender["bus"] == receiver.bus
        assert 4.9 < sender["per_s"] < 10.1 and 0.005 < sender["jitter"] < 0.02
        assert sender["latency"] == pytest.approx(receiver.latency.value, abs=1e-4)
    page = report.read_text(encoding="utf-8")
    assert "jitter at standstill" in page and "A00017000421E240" in page
    assert "<script" not in page and "Is it good" in page
    left = {one["kind"]: one for one in told["residuals"]["kinds"]}
    assert {"position", "velocity", "yaw_rate", "roll"} <= set(left)
    assert all(not one["more"] and 0.1 < one["over_stated"] < 1.0 for one in left.values())  # half the noise
    assert "over the noise that the machine file states" in page
    assert told["steering"] is None and told["steering_words"] == NEVER_STEERED and NEVER_STEERED in page
    assert "100 ms" in page and "e+0" not in page


def _looked(machine: Machine, log: Path) -> _Looked:
    decoder, heard = Decoder(machine), list[Measurement]()
    for frame in frames(log):
        heard += decoder.measurements(frame)
    return _look_at(machine, heard, lambda what, share: None)


ONE_SPEED = """
seconds = 150.0
speed = 4.5
steering = [[12.0, 0.0], [138.0, "random"]]
[soil]
grip = 0.7
[ground]
slope_deg = 1.5
"""


def test_at_one_speed_what_looks_like_a_late_receiver_is_not_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Levers and hitch were 10 cm off there with sds of 1 cm, and latencies 50 ms with sds of 6."""
    log, file, out = simulated_drive(tmp_path, ONE_SPEED), tmp_path / "wrong.toml", tmp_path / "out.toml"
    file.write_text(WRONG, encoding="utf-8")
    assert main(["calibrate", str(log), "--machine", str(file), "--out", str(out), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    numbers = {number["name"]: number for number in told["numbers"]}
    along = ("lever_t", "lever_i", "c", "d", "latency")
    assert {numbers[name]["status"] for name in along} <= {"rough", "not told"}
    assert any("one speed" in sentence for sentence in told["sentences"])
    now, truth = parse_machine(out.read_text(encoding="utf-8")), _true(log)["nuisances"]
    zero, sd = np.degrees(truth["wheel_zero"]), np.degrees(numbers["wheel_zero"]["sd"])
    assert now.wheel_angle.zero.value == pytest.approx(zero, abs=3 * sd)
    assert now.wheel_angle.scale == pytest.approx(0.01, rel=3 * numbers["wheel_gain"]["sd"])
    for receiver in now.receiver:
        delay = truth[f"latency_{receiver.mount.value}"]
        assert receiver.latency.value == pytest.approx(delay, abs=2.5 * receiver.latency.sd)


def test_a_wrong_roll_correction_leaves_nothing_in_the_places(tmp_path: Path) -> None:
    """Where the setting is found to be wrong, geometry is looked at once more: the hitch was 3 cm off."""
    log = simulated_drive(tmp_path, DRIVE.replace("slope_deg = 1.5", "slope_deg = 4.0"))
    right = _looked(MACHINE, log)
    for k in (1, 2):
        corrected = tuple(not MACHINE.receiver[i].roll_corrected if i == k else None for i in range(4))
        found = _looked(applied(MACHINE, Changes(roll_corrected=corrected)), log)
        assert [fault.kind for fault in found.faults] == ["roll_corrected"]
        assert found.changes.hitch == pytest.approx(right.changes.hitch, abs=1e-3)
        assert found.changes.lateral_offset == pytest.approx(right.changes.lateral_offset, abs=1e-3)


def test_of_another_rig(drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = tmp_path / "other.toml"
    other.write_text(MACHINE_TEXT.replace("A00017000421E24", "A00017000421F24"), encoding="utf-8")
    assert main(["calibrate", str(drive), "--machine", str(other), "--json"]) == 1
    told = json.loads(capsys.readouterr().out)
    assert "tractor_front, tractor_rear" in told["refused"] and told["written"] is None


def test_a_draft_is_told_what_to_fill_in(
    drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also below a heading with a comment behind it, as `tilth discover` writes them."""
    draft = tmp_path / "draft.toml"
    text = MACHINE_TEXT.replace("mass = 9391.0", "mass =  # FILL IN: kg")
    text = text.replace("[tractor]", "[tractor]    # distances = from its CG")
    draft.write_text(text, encoding="utf-8")
    assert main(["calibrate", str(drive), "--machine", str(draft)]) == 2
    assert "fill in tractor.mass (line 11)." in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        (["nowhere.mcap"], "nowhere.mcap"),
        ([str(MACHINE_FILE)], "jd7930-parker500.toml"),
        ([str(MACHINE_FILE), "--machine", "nowhere.toml"], "nowhere.toml"),
        ([str(MACHINE_FILE), "--machine", str(PICTURE)], "the machine file is not UTF-8 text"),
    ],
)
def test_wrong_use(arguments: list[str], match: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", *arguments]) == 2
    assert match in capsys.readouterr().err


@pytest.mark.parametrize("live", [[], ["--live"]])
@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        (["--out", "none/m.toml"], "none: there is no such folder"),
        (["--report", "none/r.html"], "none: there is no such folder"),
        (["--report", "m.toml"], "--report m.toml: give a name that ends in .html"),
        (["--out", "."], ".: a folder; give the name of a file in it"),
        (["--out", "log.mcap"], "--out log.mcap: exists, and is no machine file"),
    ],
)
def test_where_nothing_can_be_written_is_said_at_once(
    arguments: list[str], match: str, live: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    """Before anything is read or driven: that log is not even there."""
    monkeypatch.chdir(tmp_path)
    Path("log.mcap").write_bytes(b"\x89MCAP0\r\n")
    assert main(["calibrate", "gone.mcap", *live, *arguments]) == 2
    assert match in capsys.readouterr().err
    assert Path("log.mcap").read_bytes() == b"\x89MCAP0\r\n"


RECORDED = [path for path in shared_files("data") if path.suffix in (".log", ".trc", ".txt")][:6]


@pytest.mark.parametrize("log", RECORDED, ids=lambda path: path.name)
def test_recorded_traffic_is_refused(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of devices that are no such rig: one sentence, no traceback."""
    assert main(["calibrate", str(log), "--machine", str(MACHINE_FILE)]) in (1, 2)
    assert "tilth calibrate: " in capsys.readouterr().err
