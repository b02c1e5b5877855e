"""A Zenoh router in front of the recorder, in a container say: `python -m tilth.deploy.router daemon.json`.

The file is of `tilth keys FOLDER --machine FILE --host ADDRESS --router`. Who has a key gets in; the recorder
itself stays on loopback. The router runs until it is told to end.
"""

import signal
import sys
from collections.abc import Sequence

import zenoh

from tilth.logger.zenoh.session import why

ENDS = {signal.SIGINT, signal.SIGTERM}
WANTED = "give the daemon.json of `tilth keys FOLDER … --router`\n"


def main(words: Sequence[str] | None = None) -> int:
    """0 told to end, 2 no such configuration (it has said why)."""
    given = sys.argv[1:] if words is None else words
    if len(given) != 1:
        sys.stderr.write(WANTED)
        return 2
    signal.pthread_sigmask(signal.SIG_BLOCK, ENDS)  # before Zenoh's threads begin, which have it from here
    try:
        with zenoh.open(zenoh.Config.from_file(given[0])):
            signal.sigwait(ENDS)
    except zenoh.ZError as error:
        sys.stderr.write(f"{given[0]}: {why(error)}; {WANTED}")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
