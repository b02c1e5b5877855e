# Run as root of an emulated Debian by test_emulated.py. /out has the package, log.mcap, and the machine file of it.
export PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin DEBIAN_FRONTEND=noninteractive
export PIP_COMPILE=0 # byte code of everything takes minutes here
apt-get install --yes /out/tilth_*_arm64.deb
dpkg --audit
tilth-setup status
mkdir -p /etc/tilth /var/lib/tilth/logs
cp /out/machine.toml /etc/tilth/
cp /out/log.mcap /var/lib/tilth/logs/
cd /var/lib/tilth
tilth check /etc/tilth/machine.toml >/out/check.txt || true
tilth replay --verify --json logs/log.mcap >/out/verify.json

# What was recorded stays when it is removed, and is asked about when it is purged.
apt-get remove --yes tilth
test ! -e /opt/tilth && test ! -e /usr/local/bin/tilth && test -e /etc/tilth/machine.toml
cmp /out/log.mcap logs/log.mcap
while echo yes; do sleep 1; done | # what is typed before the question is lost
    DEBIAN_FRONTEND=teletype script --quiet --return --command 'apt-get purge --yes tilth' /out/asked.txt
test ! -e /etc/tilth && test ! -e /var/lib/tilth
