"""The examples of CONTRIBUTING.md, and what they make of the files that they change."""

import re

from paths import ROOT

CONTRIBUTING = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
DIFFS = re.findall(r"^```diff\n(.*?)^```", CONTRIBUTING, re.M | re.S)
FILES: dict[str, str] = dict(re.findall(r"^```python\n# (\S+)\n(.*?)^```", CONTRIBUTING, re.M | re.S))


def changed(diff: str) -> dict[str, str]:
    """File → its text with these changes. Fails where a change does not stand in exactly one place."""
    found: dict[str, str] = {}
    for part in re.split(r"^--- a/", diff, flags=re.M)[1:]:
        path, _, body = part.partition("\n")
        text = (ROOT / path).read_text(encoding="utf-8")
        for piece in re.split(r"^@@\n", body, flags=re.M):
            lines = piece.splitlines(keepends=True)
            before = "".join(line[1:] for line in lines if line[0] != "+")
            assert text.count(before) == 1, f"{path}:\n{before}"
            text = text.replace(before, "".join(line[1:] for line in lines if line[0] != "-"))
        found[path] = text
    return found
