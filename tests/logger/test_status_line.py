"""What a person sees of a run: the panel and the plain lines."""

import io

from rich.console import Console

from tilth.logger.status_line import LineDisplay, PanelDisplay, PlainDisplay, plain_line, stiffness_text
from tilth.schemas.flow import Event, ParameterEstimate, Status
from tilth.schemas.notices import in_words
from tilth.schemas.proto import tilth_pb2 as pb


def status_with(**fields: object) -> pb.Status:
    status = pb.Status(
        t_ns=1_790_000_000_000_000_000,
        uptime_s=3723,
        frames=5,
        recording=True,
        log_file="a.mcap",
        log_bytes=1_500_000,
    )
    status.buses.add(name="can0", state="open", frames_per_s=800.0)
    status.receivers.add(mount="tractor_front", state="alive", fix="rtk_fixed", age_s=0.1)
    status.receivers.add(mount="implement_rear", state="lost", age_s=4.0)
    status.wheel_angle.state = "alive"
    status.disk_free_bytes = 1e9
    status.hours_left = 240.0
    for name, value in fields.items():
        setattr(status, name, value)
    return status


def panel_text(status: pb.Status) -> str:
    stream = io.StringIO()
    display = PanelDisplay("rig", Console(file=stream, force_terminal=True, width=110, color_system=None))
    display.event(Event(status.t_ns, "bus", in_words("can0: heard again")))
    display.show(status, None)
    display.close()
    return stream.getvalue()


def test_the_panel_shows_all_at_a_glance() -> None:
    text = panel_text(status_with())
    for words in (
        "RECORDING  1:02:03",
        "can0",
        "800",
        "tractor front",
        "rtk fixed",
        "✘ lost",
        "wheel angle",
        "1.5 MB",
    ):
        assert words in text
    assert "front      unestimated" in text and "heard again" in text
    assert "NOT RECORDING" in panel_text(status_with(recording=False))


def test_failures_that_are_over_stay_in_sight() -> None:
    status = status_with()
    (bus,) = status.buses
    status.buses.add(name="can1", state="open", failures=3)
    rows = [line.split() for line in panel_text(status).splitlines()]
    assert next(row for row in rows if "can0" in row)[1:6] == ["can0", "✔", "open", "800", "tractor"]
    assert next(row for row in rows if "can1" in row)[1:7] == ["can1", "✔", "open", "0", "3", "implement"]
    assert ", can1 failed 3 times" in plain_line(status, None)
    assert "can0 failed" not in plain_line(status, None)
    bus.failures = 1
    assert ", can0 failed once, can1 failed 3 times" in plain_line(status, None)
    assert "failed" not in panel_text(status_with()) + plain_line(status_with(), None)


def test_plain_lines_say_the_same() -> None:
    stream = io.StringIO()
    display = PlainDisplay(stream)
    status = status_with()
    status.problems.extend(["disk: 5 minutes", "x"])
    display.show(status, None)
    display.show(status, None)  # one line each five seconds
    display.event(Event(status.t_ns, "bus", in_words("can0: silent")))
    first, second = stream.getvalue().splitlines()
    assert first.startswith("14:13:20Z recording, 1.5 MB, 5 frames (800/s), receivers 1/2, wheel angle alive")
    assert first.endswith("PROBLEM disk: 5 minutes (and 1 more)")
    assert second == "14:13:20Z bus: can0: silent"


def test_a_stiffness_is_a_number_only_where_there_is_one() -> None:
    assert stiffness_text(ParameterEstimate(220e3, 10e3, Status.ESTIMATED, None)) == "220 ± 20 kN/rad (95 %)"
    assert (
        stiffness_text(ParameterEstimate(220e3, 10e3, Status.STALE, None)) == "220 ± 20 kN/rad (95 %), stale"
    )
    assert stiffness_text(ParameterEstimate(None, None, Status.INVALID, None)) == "invalid"


def test_what_is_still_made_ready_is_said_with_the_time_that_is_left() -> None:
    status = status_with(preparing="compiling kernels")
    assert "wheel angle alive, compiling kernels, front" in plain_line(status, None)
    status.ready_in_s = 40.4
    assert "wheel angle alive, compiling kernels, about 40 s left, front" in plain_line(status, None)
    assert "RECORDING" in panel_text(status) and "compiling kernels, about 40 s left" in panel_text(status)
    assert "compiling" not in panel_text(status_with())


def test_one_line_is_written_anew() -> None:
    stream = io.StringIO()
    display = LineDisplay(Console(file=stream, force_terminal=True, width=80, color_system=None))
    display.show(status_with(preparing="compiling", ready_in_s=40.0), None)
    display.event(Event(0, "bus", in_words("can0: heard again")))
    display.show(status_with(), None)
    assert "\n" not in stream.getvalue()
    display.close()
    assert "… compiling, about 40 s left" in stream.getvalue() and "heard again" not in stream.getvalue()
    assert "62:03  driving; nothing known about the tyres yet" in stream.getvalue()
