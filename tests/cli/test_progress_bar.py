"""Long work tells of itself also where nobody looks at a bar."""

from contextlib import ExitStack

import pytest

from tilth.cli.progress_bar import bars, stages


def test_a_pipe_gets_a_line_now_and_then(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = iter([0.0, *(3.0 * k for k in range(1, 40))])
    monkeypatch.setattr("tilth.cli.progress_bar.time.monotonic", lambda: next(clock))
    with ExitStack() as stack:
        show = bars(stack)
        for done in range(10):  # 3 s each
            show("fitting", done, 10)
    assert capsys.readouterr().err.splitlines() == ["fitting: 30 %", "fitting: 70 %"]


def test_short_work_is_silent(capsys: pytest.CaptureFixture[str]) -> None:
    with ExitStack() as stack:
        stages(stack)("reading", 0.5)
    assert capsys.readouterr().err == ""
