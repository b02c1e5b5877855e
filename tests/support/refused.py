"""Runs words in a process whose kernel refuses a system call, as the filter of a service or a share does.

As a script: refused.py CALL=ERROR WORD…, such as flock=EOPNOTSUPP. By seccomp(2), so it takes no compiler.
"""

import ctypes
import errno
import os
import platform
import struct
import sys
from pathlib import Path
from typing import Final

import pytest

_CALLS: Final = {"x86_64": {"flock": 73, "setpriority": 141}, "aarch64": {"flock": 32, "setpriority": 140}}
_NO_NEW_PRIVS, _SET_SECCOMP, _FILTER = 38, 22, 2  # of prctl(2)
_LOAD, _JUMP_EQUAL, _RETURN = 0x20, 0x15, 0x06  # of the kernel's BPF
_ALLOW, _ERRNO = 0x7FFF0000, 0x00050000


def refusing(call: str, error: str) -> list[str]:
    """What to put before the words of a command. Skips where this kernel cannot."""
    if sys.platform != "linux" or platform.machine() not in _CALLS:
        pytest.skip(f"no numbers of system calls are known for {platform.machine()}")
    return [sys.executable, str(Path(__file__)), f"{call}={error}"]


def _refuse(number: int, error: int) -> None:
    steps = (
        (_LOAD, 0, 0, 0),
        (_JUMP_EQUAL, 0, 1, number),
        (_RETURN, 0, 0, _ERRNO | error),
        (_RETURN, 0, 0, _ALLOW),
    )
    code = ctypes.create_string_buffer(b"".join(struct.pack("HBBI", *step) for step in steps))
    program = struct.pack("HxxxxxxP", len(steps), ctypes.addressof(code))
    libc = ctypes.CDLL(None, use_errno=True)
    for words in ((_NO_NEW_PRIVS, 1, 0, 0, 0), (_SET_SECCOMP, _FILTER, ctypes.c_char_p(program), 0, 0)):
        if libc.prctl(*words):
            raise OSError(ctypes.get_errno(), "prctl")


if __name__ == "__main__":
    call, _, name = sys.argv[1].partition("=")
    _refuse(_CALLS[platform.machine()][call], getattr(errno, name))
    os.execv(sys.argv[2], sys.argv[2:])
