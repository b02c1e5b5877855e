"""Names of files as text that can be stored and published: on a disk they are bytes, some not UTF-8."""


def readable(name: object) -> str:
    r"""As a person reads it, what is in no encoding escaped: caf\udce9."""
    return str(name).encode(errors="backslashreplace").decode()
