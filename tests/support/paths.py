"""Where the checkout is, and what is beside it in a workplace only."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SUPPORT = ROOT / "tests" / "support"
SHARED = ROOT.parent / "shared"
MACHINE_FILE = ROOT / "deploy" / "machines" / "jd7930-parker500.toml"  # the packaged rig
