"""`tilth compare`: what is the same stays within chance, another soil does not; what cannot be compared."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from fit_answer import answer
from recorded import marked, recorded, shared_cache

from tilth.cli import main

Answer = Callable[..., tuple[int, str, str]]


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Answer:
    """(status, stdout, stderr) of `tilth …`."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(shared_cache()))

    def of(*words: str | Path) -> tuple[int, str, str]:
        status = main([str(word) for word in words])
        out, err = capsys.readouterr()
        return status, out, err

    return of


@pytest.mark.long
def test_nothing_differs_between_a_log_and_itself(call: Answer, tmp_path: Path) -> None:
    status, out, _ = call("fit", recorded().parts[0], "--json")
    saved = tmp_path / "fit.json"
    saved.write_text(out)
    assert status == 0
    status, out, _ = call("compare", recorded().parts[0], saved, "--json")
    found = json.loads(out)
    assert status == 0 and found["chi2"] == 0.0 and "they are of one drive" in found["sentence"]
    status, out, _ = call("compare", saved, marked())  # of which only one step is marked
    assert status == 0 and "C_af" in out


def test_another_soil_is_told(call: Answer, tmp_path: Path) -> None:
    paths = [tmp_path / "a.json", tmp_path / "b.json"]
    for path, found in zip(paths, (answer(), answer({"C_af": 1e5})), strict=True):
        path.write_text(json.dumps(found))
    status, out, _ = call("compare", *paths)
    assert status == 1 and "C_af × 0.50 (0.38 to 0.66)" in " ".join(out.split())


def test_what_cannot_be_compared(call: Answer, tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.json"
    wrong.write_text("[1, 2")
    good = tmp_path / "good.json"
    good.write_text(json.dumps(answer()))
    for words, says in (
        ((wrong, good), "not what `tilth fit --json` writes"),
        ((good, tmp_path / "no.mcap"), "no such file"),
        ((good, good, "--machine", "a", "--machine", "b", "--machine", "c"), "once for both, or twice"),
    ):
        status, _, err = call("compare", *words)
        assert status == 2 and says in err


def test_published_values_stand_beside_a_fit_and_are_no_fault(call: Answer, tmp_path: Path) -> None:
    good, wrong = tmp_path / "good.json", tmp_path / "wrong.toml"
    good.write_text(json.dumps(answer()))
    status, out, _ = call("compare", good, "published")
    told = " ".join(out.split())
    assert status == 0 and "Karkee" in told and "a difference is no fault" in told and "no sd" in told
    status, out, _ = call("compare", good, "published", "--json")
    first = json.loads(out)["published"][0]["parameters"][0]
    assert first["name"] == "C_af" and first["ratio"] == pytest.approx(200 / 90)
    wrong.write_text("a = 1")
    status, _, err = call("compare", good, wrong)
    assert status == 2 and "give [[entry]]" in err
    assert call("compare", good, tmp_path / "none.toml")[0] == 2
