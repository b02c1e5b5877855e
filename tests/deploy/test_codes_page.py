"""The page of codes is the one that the tables of words give, and names every code."""

from paths import ROOT

from tilth.deploy import codes_page
from tilth.schemas.notices import NoticeCode
from tilth.schemas.reasons import Code
from tilth.schemas.rejections import Rejection


def test_the_page_is_current_and_names_every_code() -> None:
    page = (ROOT / codes_page.TARGET).read_text(encoding="utf-8")
    assert page == codes_page.text(), "uv run python -m tilth.deploy.generate"
    for title, codes in (("Reasons", Code), ("Notices", NoticeCode), ("Rejections", Rejection)):
        section = page.partition(f"## {title}")[2].partition("\n## ")[0]
        assert all(f"| `{code}` |" in section for code in codes)
        assert "{" not in section
