"""How child processes die: real ones. What is said of each death, and that nothing is left of it."""

import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path

import pytest
from loopback import until

from tilth.logger import job
from tilth.logger.child import packed, unpacked, words_of
from tilth.logger.job import NO_ANSWER, OUT_OF_MEMORY, STOPPED, Job, JobEnded

PYTHON = [sys.executable, "-c"]
SLEEPS = "import signal; signal.pause()"
ECHO = "import sys\nfor line in sys.stdin.buffer:\n    sys.stdout.buffer.write(line)\n    sys.stdout.flush()"
FLOOD = "import sys\nwhile True: sys.{}.write('x' * 65536)"
KILLS_ITSELF = "import os, sys; print('no room', file=sys.stderr); os.kill(os.getpid(), {})"


@pytest.fixture(autouse=True)
def no_child_is_left() -> Iterator[None]:
    """Neither one that runs nor one whose end nobody has taken."""
    before = children()
    yield
    assert children() <= before  # others' fixtures may have theirs


def children() -> set[str]:
    """Process numbers of this one's, also of those whose end nobody has taken."""
    tasks = Path("/proc/self/task").iterdir()
    return {pid for task in tasks for pid in (task / "children").read_text().split()}


def gone(pid: int) -> bool:
    """Whether a process, whoever's child it is, runs no more."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True


def answer(code: str, lines: Sequence[bytes] | None = None, longest_s: float = 60.0) -> bytes | None:
    with closing(Job([*PYTHON, code], lines, longest_s=longest_s)) as one:
        return one.next()


# name -> what it does, and what is said of that
DEATHS: dict[str, tuple[str, str]] = {
    "killed": (KILLS_ITSELF.format(9), OUT_OF_MEMORY),
    "killed below a shell": ("raise SystemExit(137)", OUT_OF_MEMORY),
    "told to end": (KILLS_ITSELF.format(15), "it was ended by SIGTERM"),
    "crashes": (KILLS_ITSELF.format(11), "it crashed (SIGSEGV)"),
    "fails with a word": ("raise SystemExit('\\ntilth report: no room \\n\\n')", "no room "),
    "fails without": ("raise SystemExit(3)", "it ended with status 3"),
    "fails with a trace": ("{}['x']", "KeyError: 'x'"),
    "says nothing": ("", NO_ANSWER),
    "half a line": ("print('{', end='')", NO_ANSWER),
    "hangs": (SLEEPS, "it was not ready within 0.3 s"),
    "closes its mouth": (f"import os; os.close(1); {SLEEPS}", "it was not ready within 0.3 s"),
    "complains for ever": (FLOOD.format("stderr"), "it was not ready within 0.3 s"),
    "reads nothing": (f"{SLEEPS}  # {'x' * 9}", "it was not ready within 0.3 s"),
    "talks for ever": (FLOOD.format("stdout"), "it said more than 1 MB"),
}


@pytest.mark.parametrize("name", DEATHS)
def test_each_death_has_its_sentence(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(job, "LARGEST", 1_000_000)
    code, expected = DEATHS[name]
    told = [b"x" * 1_000_000] if name == "reads nothing" else None
    with pytest.raises(JobEnded) as ended:
        answer(code, told, 0.3 if "0.3" in expected else 60.0)
    assert str(ended.value) == expected


@pytest.mark.parametrize("words", [["/nowhere/python"], ["/etc/passwd"]])
def test_one_that_cannot_be_started_says_why(words: list[str]) -> None:
    with pytest.raises(JobEnded, match=f"^{words[0]}: (no such file or directory|permission denied)$"):
        Job(words)


def test_what_is_larger_than_a_pipe_goes_both_ways() -> None:
    line = os.urandom(500_000).hex().encode()
    with closing(Job([*PYTHON, ECHO], [line], longest_s=60.0)) as one:
        assert one.next() == line
        one.send(line[:7])
        one.send(b"")
        assert (one.next(), one.next(), one.next(0.0)) == (line[:7], b"", None)


def test_one_that_complains_more_than_a_pipe_holds_still_answers() -> None:
    code = "import sys; sys.stderr.write('word ' * 99999 + '\\nlast'); print('said')\nraise SystemExit(1)"
    with closing(Job([*PYTHON, code])) as one:
        assert one.next() == b"said"
        assert one.end() == "last"


def test_lines_end_with_it_and_say_where_it_failed() -> None:
    with closing(Job([*PYTHON, "print('a\\nb')"])) as one:
        assert list(one.lines()) == [b"a", b"b"]
    with closing(Job([*PYTHON, "print('a')\nraise SystemExit('no room')"])) as one:
        told = one.lines()
        assert next(told) == b"a"
        with pytest.raises(JobEnded, match=r"^no room$"):
            next(told)


@pytest.mark.parametrize(
    ("code", "expected"),
    [("print('[1')", NO_ANSWER), ("print('no\\nJSON')\nraise SystemExit('no room')", "no room")],
)
def test_what_is_no_json_is_no_answer(code: str, expected: str) -> None:
    with closing(Job([*PYTHON, code])) as one, pytest.raises(JobEnded, match=f"^{expected}$"):
        one.json()
    with closing(Job([*PYTHON, ECHO], [b"[1]"])) as one:
        assert one.json() == [1]  # it is told that no more comes
    # An answer counts whatever the exit status says.
    with closing(Job([*PYTHON, "print([1])\nraise SystemExit(1)"])) as one:
        assert one.json() == [1]


@pytest.mark.parametrize("line", [b"", b"{}", b"x" * 99, packed(1)[:-4]])
def test_garbage_is_no_answer_between_parent_and_child(line: bytes) -> None:
    with pytest.raises(ValueError, match="no answer"):
        unpacked(line)
    assert unpacked(packed([1.5])) == unpacked(packed([1.5]) + b"\n") == [1.5]


def test_whoever_looks_now_and_then_never_holds_it_up() -> None:
    with closing(Job([*PYTHON, "import sys; sys.stderr.write('x' * 999999)"])) as one:
        until(lambda: not one.alive)
        assert one.end() == ""


def test_another_thread_ends_one_that_is_waited_for() -> None:
    with closing(Job([*PYTHON, SLEEPS])) as one:
        other = threading.Timer(0.05, one.kill, ["another is wanted"])
        other.start()
        with pytest.raises(JobEnded, match=r"^another is wanted$"):
            one.next()
        other.join()
        one.kill()  # nobody any more
        assert one.end() == "another is wanted"


IGNORES = "import signal; signal.signal(15, signal.SIG_IGN); print('on', flush=True); signal.pause()"
BEARS = f"import subprocess, sys; c = subprocess.Popen([sys.executable, '-c', {SLEEPS!r}]); print(c.pid)"


def test_one_that_does_not_want_to_end_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(job, "ENDING_S", 0.1)
    one = Job([*PYTHON, IGNORES])
    assert one.next() == b"on"
    one.close()
    one.close()
    assert gone(one.pid)


def test_one_that_is_told_to_end_may_tidy_up(tmp_path: Path) -> None:
    word = tmp_path / "word"
    tidies = f"import pathlib, signal; signal.signal(15, lambda *_: pathlib.Path({str(word)!r}).touch())"
    with closing(Job([*PYTHON, f"{tidies}; print('on', flush=True); signal.pause()"])) as one:
        assert one.next() == b"on"
    assert word.exists()


@pytest.mark.parametrize("goes_on", [f"; import sys; sys.stdout.flush(); {SLEEPS}", ""])
def test_what_it_has_started_ends_with_it(goes_on: str) -> None:
    """Also where it holds the pipes of one that has ended already."""
    with closing(Job([*PYTHON, BEARS + goes_on])) as one:
        line = one.next()
        assert line is not None
        if not goes_on:
            assert one.end() == ""
    until(lambda: gone(int(line)))


# How a parent starts a child, `one`, whose id it tells
CHILDREN = {
    "a job": "from tilth.logger.child import words_of\nfrom tilth.logger.job import Job\n"
    "one = Job(words_of('hanging')).pid",
    "a pool": "from tilth.analysis.fit.side_by_side import processes\n"
    "one = stack.enter_context(processes(2)).submit(os.getpid).result()",
    "a pool of new processes": "from tilth.analysis.fit.side_by_side import processes\n"
    "one = stack.enter_context(processes(2, 'spawn')).submit(os.getpid).result()",
}
PARENT = """
import contextlib, os, signal
with contextlib.ExitStack() as stack:
    {}
    print(one, flush=True)
    signal.pause()
"""


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """One that hangs, and hears of nothing."""
    (tmp_path / "hanging.py").write_text(f"print('on', flush=True); {SLEEPS}")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    return "hanging"


@pytest.mark.parametrize("child", CHILDREN)
@pytest.mark.usefixtures("module")
def test_no_child_outlives_a_parent_that_is_killed(child: str) -> None:
    code = PARENT.format(CHILDREN[child].replace("\n", "\n    "))
    with closing(Job([*PYTHON, code])) as parent:
        line = parent.next()
        assert line is not None
        os.kill(parent.pid, signal.SIGKILL)
        until(lambda: gone(int(line)))
        assert parent.end() == OUT_OF_MEMORY


def test_a_parent_that_was_dead_by_then_is_noticed(module: str) -> None:
    words = words_of(module)
    with closing(Job([str(os.getppid()) if word == str(os.getpid()) else word for word in words])) as one:
        assert one.end() == "it ended with status 1"


def test_a_module_runs_as_it_would_by_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "words.py").write_text("import sys; print(__name__, *sys.argv)")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with closing(Job(words_of("words", "a", "b c"))) as one:
        assert one.next() == f"__main__ {tmp_path / 'words.py'} a b c".encode()


def test_ctrl_c_in_the_terminal_is_not_for_it() -> None:
    with closing(Job([*PYTHON, SLEEPS])) as one:
        assert os.getpgid(one.pid) == one.pid
        assert os.getsid(one.pid) == os.getsid(0)  # another session would be as urgent as this one
        one.kill()
        assert one.end() == STOPPED
