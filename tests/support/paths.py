"""Where the checkout is, and what is beside it in a workplace only."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SUPPORT = ROOT / "tests" / "support"
MACHINE_FILE = ROOT / "deploy" / "machines" / "jd7930-parker500.toml"  # the packaged rig


_SHARED = ROOT.parent / "shared"


def shared(name: str) -> Path:
    """A file or folder beside the checkout; who asks is skipped, with this reason, where it is not there."""
    import pytest  # programs without tests have paths too

    path = _SHARED / name
    if not path.exists():
        pytest.skip(f"{path} is not on this computer")
    return path


def shared_files(name: str) -> list[Path]:
    """All in a folder there, for parametrize; none where it is not there."""
    return sorted(path for path in (_SHARED / name).rglob("*") if path.is_file())
