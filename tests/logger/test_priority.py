"""Fits, reports and the compiling stand behind the recorder; where that is refused they run all the same."""

import os
import subprocess
import sys

import pytest
from logs import MACHINE
from refused import refusing

from tilth.logger import priority
from tilth.logger.child import packed

REFUSED = ("setpriority", "EPERM")


@pytest.mark.parametrize("own", [0, 7, 15])
def test_it_counts_from_zero_whatever_the_recorders_own_is(own: int) -> None:
    """The service's is less than zero: what is nicer than it by ten would be as urgent as all else."""
    before = min(os.getpriority(os.PRIO_PROCESS, 0) + own, 19)  # the tests may run under `nice`
    with subprocess.Popen(["sleep", "60"], preexec_fn=lambda: os.nice(own)) as process:  # noqa: PLW1509
        said = priority.stand_behind(priority.FITS, process.pid)
        after = os.getpriority(os.PRIO_PROCESS, process.pid)
        process.kill()
    assert (said, after) == ("", max(before, priority.FITS))
    assert priority.stand_behind(priority.FITS, process.pid) == ""  # it has ended


FITS = """
import os, sys, time
from logs import MACHINE
from tilth.logger.fitting import Worker
from tilth.schemas.sentences import notice_sentence
said = []
worker = Worker(MACHINE, lambda kind, told: said.append(notice_sentence(told)))
worker.start()
deadline = time.monotonic() + 120.0
while not (said if REFUSED else worker._job) and time.monotonic() < deadline:
    time.sleep(0.01)
print(os.getpriority(os.PRIO_PROCESS, worker._job.pid), said)
worker.close()
"""


@pytest.mark.parametrize("refused", [False, True])
def test_fits_run_behind_or_say_why_not(refused: bool) -> None:
    code = FITS.replace("REFUSED", str(refused))
    done = subprocess.run(
        [*(refusing(*REFUSED) if refused else ()), sys.executable, "-c", code],
        capture_output=True, text=True, check=True, env=os.environ | {"PYTHONPATH": ":".join(sys.path)},
    )  # fmt: skip
    own = os.getpriority(os.PRIO_PROCESS, 0)
    if refused:
        assert done.stdout == (
            f'{own} ["fits are made at the recorder\'s own priority: operation not permitted"]\n'
        )
    else:
        assert done.stdout == f"{max(own, priority.FITS)} []\n"


@pytest.mark.usefixtures("prepared")
@pytest.mark.long
def test_the_compiling_does_not_die_of_a_refusal() -> None:
    done = subprocess.run(
        [*refusing(*REFUSED), sys.executable, "-P", "-m", "tilth.logger.compiling", "-"],
        input=packed(MACHINE), capture_output=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr.decode()


def test_a_report_does_not_die_of_it() -> None:
    show = "from tilth.cli.background import step_back; step_back(); print('on')"
    done = subprocess.run(
        [*refusing(*REFUSED), sys.executable, "-P", "-c", show], capture_output=True, text=True, check=True
    )
    assert done.stdout == "on\n"
