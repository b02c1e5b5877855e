"""What goes wrong with logs and files, as a sentence and an exit status: for all commands that read logs."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tilth.cli import CommandFailed
from tilth.replay.readers.log import LogError
from tilth.schemas.readable import reason_of


@contextmanager
def log_errors(what: str | Path | None = None, after: str = "") -> Iterator[None]:
    """what: named where an error names no file. after: in words, what has become of what was to be written.

    Raises CommandFailed: 2 where a file is not there, or is no log; else 1.
    """
    try:
        yield
    except LogError as error:
        raise CommandFailed(str(error), error.status) from None
    except (PermissionError, BrokenPipeError):
        raise  # cli.main knows what to say
    except OSError as error:
        text = f"{error.filename or what or 'log'}: {reason_of(error)}"
        text += f"; {after}" if after else ""
        raise CommandFailed(text, 2 if isinstance(error, FileNotFoundError) else 1) from None
