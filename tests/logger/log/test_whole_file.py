"""Files that are whole or not there, and reading what may be anything."""

import os
from pathlib import Path

import pytest

from tilth.logger.log import whole_file


def left(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_a_name_is_given_when_all_is_written(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    with whole_file.whole(path) as part:
        part.write_bytes(b"one")
        assert not path.exists()
    assert left(tmp_path) == {"a.txt": b"one"}
    whole_file.write(path, b"two")
    assert left(tmp_path) == {"a.txt": b"two"}


@pytest.mark.parametrize("error", [OSError, KeyboardInterrupt])
def test_a_failure_leaves_what_was_there(tmp_path: Path, error: type[BaseException]) -> None:
    path = tmp_path / "a.txt"
    path.write_bytes(b"before")
    with pytest.raises(error), whole_file.whole(path, replace=True) as part:
        part.write_bytes(b"half")
        raise error
    assert left(tmp_path) == {"a.txt": b"before"}


def test_nothing_is_replaced_that_came_meanwhile(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    with pytest.raises(FileExistsError, match="exists"), whole_file.whole(path) as part:
        part.write_bytes(b"ours")
        path.write_bytes(b"theirs")
    assert left(tmp_path) == {"a.txt": b"theirs"}
    with pytest.raises(FileExistsError), whole_file.whole(path):
        pytest.fail("it was there already")


def test_what_was_left_unwritten_gets_no_name(tmp_path: Path) -> None:
    with whole_file.whole(tmp_path / "a.txt") as part:
        part.write_bytes(b"")
        part.unlink()
    assert left(tmp_path) == {}


def test_reading_never_waits_and_takes_plain_files_only(tmp_path: Path) -> None:
    plain, pipe = tmp_path / "plain", tmp_path / "pipe"
    plain.write_bytes(b"text")
    assert whole_file.read(plain) == b"text"
    os.mkfifo(pipe)
    for path in (pipe, Path("/dev/zero")):
        with pytest.raises(OSError, match="is no file"):
            whole_file.read(path)
    with pytest.raises(IsADirectoryError):
        whole_file.read(tmp_path)
    os.truncate(plain, whole_file.LARGEST + 1)
    with pytest.raises(OSError, match="too large"):
        whole_file.read(plain)


def test_what_is_for_root_alone_replaces_what_others_could_read(tmp_path: Path) -> None:
    path = tmp_path / "label.toml"
    path.write_text("before")
    path.chmod(0o644)
    whole_file.write(path, b"secret", mode=0o600)
    assert path.read_bytes() == b"secret" and path.stat().st_mode & 0o777 == 0o600
