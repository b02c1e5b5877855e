"""Signatures in minisign's form: as the program itself makes and reads them, and none that was changed."""

import shutil
import subprocess
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from releases import SigningKey

from tilth.deploy.minisign import ForgedError, FormError, Signature, read_key, read_signature, verify

# Made by minisign 0.11, of a file with the line "hello".
PUBLIC = """untrusted comment: minisign public key 7204C5952806BB2A
RWQquwYolcUEcgIsxz8+XzZEP1HmCk8l5f5SK7W/pt48MTwyv4ZJwRYu
"""
SIGNED = """untrusted comment: untrusted
RUQquwYolcUEctxo1wH66rsHIuWmytnRix+72VSEd+XW55wmZWaEL9gg0x/uWNOK+KsJaXG/3OlWpxGJDK98p3wQ689gtZf/VAg=
trusted comment: tilth 0.2.0
eLiY50+YZnf3io1W5pkFJR3OYKFbh6kPbiTpPh+Y7GqK+U5t9/k4twA/1DJTTqXwvbmkw2mcm4OXBpYhT583CA==
"""
needs_minisign = pytest.mark.skipif(
    shutil.which("minisign") is None, reason="no minisign: apt-get install it"
)


@pytest.fixture
def hello(tmp_path: Path) -> Path:
    path = tmp_path / "hello"
    path.write_text("hello\n")
    return path


def test_what_minisign_has_signed_is_verified(hello: Path) -> None:
    name, key = read_key(PUBLIC)
    signature = read_signature(SIGNED)
    assert (name, signature.key, signature.comment) == ("7204C5952806BB2A", name, "tilth 0.2.0")
    verify(hello, signature, key)
    with pytest.raises(ForgedError, match="hello is not what 7204C5952806BB2A has signed"):
        verify(hello, signature, SigningKey(3).key.public_key())


@given(place=st.integers(0, 5), bit=st.integers(0, 7))
def test_no_other_bit_of_the_file_is_taken(
    place: int, bit: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    content = bytearray(b"hello\n")
    content[place] ^= 1 << bit
    path = tmp_path_factory.getbasetemp() / "changed"
    path.write_bytes(content)
    with pytest.raises(ForgedError):
        verify(path, read_signature(SIGNED), read_key(PUBLIC)[1])


@given(data=st.data())
def test_no_other_signature_or_comment_is_taken(
    data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """But for the first line, which nobody signs; whatever it is instead is one of two errors."""
    path = tmp_path_factory.getbasetemp() / "hello"
    path.write_text("hello\n")
    first, _, rest = SIGNED.partition("\n")
    place = data.draw(st.integers(0, len(rest) - 2))
    changed = rest[:place] + data.draw(st.characters(codec="ascii")) + rest[place + 1 :]
    read = read_or_none(f"{first}\n{changed}")
    if read is not None and (read == read_signature(SIGNED) or read.key != read_signature(SIGNED).key):
        return  # of another key, which is then looked for
    with pytest.raises((FormError, ForgedError)):
        verify(path, read_signature(f"{first}\n{changed}"), read_key(PUBLIC)[1])


def read_or_none(text: str) -> Signature | None:
    try:
        return read_signature(text)
    except FormError:
        return None


@pytest.mark.parametrize(
    "text",
    ["", "untrusted comment: x", PUBLIC.replace("RWQ", "XXX"), PUBLIC.replace("RYu", ""), "é", SIGNED],
)
def test_what_is_no_public_key_is_said_to_be_none(text: str) -> None:
    with pytest.raises(FormError):
        read_key(text)


def test_a_signature_over_the_whole_file_is_refused() -> None:
    """The older kind: it would have to be in memory."""
    with pytest.raises(FormError, match="another kind than ED"):
        read_signature(SIGNED.replace("RUQ", "RWQ"))


@needs_minisign
def test_minisign_and_these_tests_sign_alike(hello: Path, tmp_path: Path) -> None:
    key = SigningKey(7)
    key.sign(hello, "of the tests")
    public = tmp_path / "key.pub"
    public.write_text(key.public())
    said: list[str | Path] = ["minisign", "-V", "-p", public, "-m", hello]
    done = subprocess.run(said, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and "Trusted comment: of the tests" in done.stdout, done.stderr
