"""The code of the label: who brings it is let in, and nobody finds it by trying."""

import pytest

from tilth.monitor.entry_code import EACH_S, LETTERS, MOST, EntryCode, TooSoon, new_code


class Watch:
    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


@pytest.mark.parametrize("typed", ["ABCD-2340", "abcd2340", " abcd 234o ", "A-B-C-D-2-3-4-O"])
def test_however_it_is_typed(typed: str) -> None:
    entry = EntryCode("abcd-2340")
    cookie = entry.take("192.168.1.7", typed)
    assert cookie and entry.knows(cookie)
    assert EntryCode("ABCD2340").knows(cookie)  # after a restart too
    assert not EntryCode("ABCD2341").knows(cookie)  # but not after a change of the label


@pytest.mark.parametrize("typed", ["", "ABCD-234", "ABCD-23400", "ü" * 9, "ABCD-2340\0", "x" * 100_000])
def test_a_wrong_one_lets_in_nobody(typed: str) -> None:
    assert EntryCode("ABCD-2340").take("192.168.1.7", typed) == ""


@pytest.mark.parametrize("cookie", ["", ".", "x", "x.y", "x." + "0" * 64, "ü.ü", "." + "f" * 64])
def test_a_cookie_that_was_not_given_is_none(cookie: str) -> None:
    assert not EntryCode("ABCD-2340").knows(cookie)


def test_a_changed_cookie_is_none() -> None:
    entry = EntryCode("ABCD-2340")
    cookie = entry.take("", "ABCD-2340")
    assert entry.knows(cookie)
    assert not any(entry.knows(cookie[:i] + "~" + cookie[i + 1 :]) for i in range(len(cookie)))


def test_one_try_a_second_also_of_the_right_code() -> None:
    watch = Watch()
    entry = EntryCode("ABCD-2340", watch)
    assert entry.take("192.168.1.7", "wrong") == ""
    with pytest.raises(TooSoon):
        entry.take("192.168.1.7", "ABCD-2340")
    assert entry.take("192.168.1.8", "ABCD-2340")  # another one is not kept out by the first
    watch.now_s += EACH_S
    assert entry.take("192.168.1.7", "ABCD-2340")


def test_a_crowd_of_addresses_tries_no_faster() -> None:
    watch = Watch()
    entry = EntryCode("ABCD-2340", watch)
    for i in range(MOST):
        assert entry.take(f"fe80::{i}", "wrong") == ""
    with pytest.raises(TooSoon):
        entry.take("fe80::ffff", "ABCD-2340")
    years = len(LETTERS) ** 8 / (MOST / EACH_S) / 31_557_600
    assert years > 1000


@pytest.mark.parametrize("code", ["", "ABCD-234", "----------", "ÄÖÜ-ABCDE", "ABCD 23"])
def test_a_code_that_keeps_nobody_out_is_refused(code: str) -> None:
    with pytest.raises(ValueError, match="8 letters"):
        EntryCode(code)


def test_new_codes_are_good_and_differ() -> None:
    codes = {new_code() for _ in range(50)}
    assert len(codes) == 50
    for code in codes:
        EntryCode(code)
