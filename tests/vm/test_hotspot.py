"""The hotspot of `tilth-setup phone` on a radio: a phone joins by the label and opens the page with the code.

Two virtual radios of the kernel (mac80211_hwsim) in the virtual machine; Debian's NetworkManager opens the
network by the profile, wpa_supplicant joins it as a phone does. Minutes: `pytest -m vm_systemd -n 0`.
"""

import json
from pathlib import Path

import guest
import pytest

LABEL = """\
code = "7K2M-9XQ4"
network = "Tilth-SDHV" # for which NetworkManager by itself takes channel 13, and may not open it
passphrase = "ABCD-2345-EFGH"
"""
PAGES = guest.CHECKOUT / "monitor/page"
RADIO = ("mac80211_hwsim", "ccm", "ctr", "cmac", "gcm")  # modules: two radios, and what WPA2 encrypts with
PACKAGES = (
    "network-manager", "libnm0", "libndp0", "libmm-glib0", "libteamdctl0", "libbluetooth3", "wpasupplicant",
    "iw", "libnl-genl-3-200", "dnsmasq-base", "libjim0.81", "libnftables1", "wireless-regdb",
)  # fmt: skip


@pytest.mark.vm_systemd
@pytest.mark.skipif(guest.missing() != "", reason=guest.missing())
def test_a_phone_joins_by_the_label_and_opens_the_page_with_the_code(tmp_path: Path) -> None:
    scenario = ["env", f"PACKAGES={guest.unpacked(PACKAGES)}", "bash", "-ex", "tests/vm/hotspot.sh"]
    out = tmp_path / "out"
    out.mkdir()
    (out / "label.toml").write_text(LABEL)
    with guest.boot(scenario, out, modules=RADIO) as machine:
        machine.finish()
    before, after, heard = ((out / name).read_text() for name in ("before", "after", "heard"))
    assert before == (PAGES / "enter.html").read_text().replace("{told}", "")
    assert after == (PAGES / "setup.html").read_text() and json.loads(heard)["listens"]
