"""A change of behaviour shows as a diff of a small file, which `--refresh` rewrites."""

import csv
import io
from pathlib import Path

import pytest
from circle import demo_machine

from tilth.estimator.fold import initial, step
from tilth.schemas.flow import PARAMETERS, Estimate, Pose
from tilth.simulator.traffic import simulate

GOLDEN = Path(__file__).parent / "golden" / "demo_seed_1.csv"
COLUMNS = {  # name -> tolerance: other machines round differently, and a filter carries that on
    "t_s": 1e-6, "x": 2e-3, "y": 2e-3, "psi_t": 1e-4, "articulation": 1e-4, "u": 1e-3, "v": 1e-3, "r_t": 1e-5,
    "delta": 1e-5, "flags": 0.0, "C_af": 2e2, "C_ar": 2e2, "C_ai": 2e2,
}  # fmt: skip


def _rows() -> list[list[str]]:
    """One row each five seconds of the demo's first 90 s."""
    machine = demo_machine()
    state = initial(machine)
    rows: list[list[str]] = [list(COLUMNS)]
    numbers: list[str] = ["", "", ""]
    start = None
    for frame in simulate(machine, 1, 90.0):
        for publication in step(state, frame):
            value = publication.value
            if isinstance(value, Estimate) and value.method == "steady_state":
                numbers = ["" if p.value is None else f"{p.value:.0f}" for p in value.parameters[:3]]
            if isinstance(value, Pose):
                start = start or value.t_ns
                if (value.t_ns - start) % 5_000_000_000 == 0:
                    rows.append([*_pose_row(value, start), *numbers])
    assert [*COLUMNS][-3:] == [*PARAMETERS[:3]]
    return rows


def _pose_row(pose: Pose, start: int) -> list[str]:
    tractor = pose.tractor
    values = (
        tractor.x, tractor.y, tractor.heading, pose.articulation, tractor.forward_velocity,
        tractor.lateral_velocity, tractor.yaw_rate, pose.wheel_angle,
    )  # fmt: skip
    numbers = ["" if v is None else f"{v:.5f}" for v in values]
    return [f"{(pose.t_ns - start) * 1e-9:.1f}", *numbers, " ".join(map(str, pose.flags))]


def test_the_demo_behaves_as_it_did(request: pytest.FixtureRequest) -> None:
    rows = _rows()
    if request.config.getoption("--refresh"):
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows(rows)
        GOLDEN.parent.mkdir(exist_ok=True)
        GOLDEN.write_text(text.getvalue())
    with GOLDEN.open() as file:
        expected = list(csv.reader(file))
    assert len(rows) == len(expected) and rows[0] == expected[0]
    for row, golden in zip(rows[1:], expected[1:], strict=True):
        for name, new, old in zip(rows[0], row, golden, strict=True):
            same = new == old or (
                new and old and name != "flags" and abs(float(new) - float(old)) <= COLUMNS[name]
            )
            assert same, f"{name} at {row[0]} s: {new} instead of {old}"
