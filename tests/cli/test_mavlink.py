"""x"""

import pytest

from tilth.cli import main


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--to", "udpin:0.0.0.0:14550"), "it sends only; give udpout:HOST:PORT"),
        (("--to", "/dev/ttyACM0"), "a serial port is reached through mavlink-router or MAVProxy"),
        (("--to", "udpout:127.0.0.1:0"), "give udpout:HOST:PORT"),
        (("--to", "udpout:127.0.0.1:14550", "--system", "256"), "give a number from 1 to 255"),
        (("--to", "udpout:127.0.0.1:14550", "--machine", "a/b"), "give its name in the machine file"),
        (("--to", "udpout:127.0.0.1:14550", "--connect", "nonsense"), "one looks like"),
    ],
)
def test_wrong_use_is_told_in_one_line(
    words: tuple[str, ...], expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(("mavlink", *words)) == 2
    error = capsys.readouterr().err
    assert expected in error and error.count("\n") == 1
