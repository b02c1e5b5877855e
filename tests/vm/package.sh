# Run under a systemd of its own by test_package_systemd.py. $OUT has machine.toml, resting.toml (the same, at
# rest soon), ours.pub, and releases in folders: first, second, waits, crashes, silent. $NEEDED: what Tilth
# needs, where the packages bring Tilth alone. $TRIAL_S: of an update.
PS4='+ ${SECONDS} s: '
ready() { for _ in $(seq "$1"); do if eval "$2"; then return 0; fi; sleep 1; done; return 1; }
state() { systemctl show tilth --property=ActiveState,NRestarts,StatusText; }
records() { ready 120 "state | grep -E 'StatusText=(recording|ready)'"; }
version() { readlink -f "/opt/tilth/$1/lib/python3"*/site-packages/tilth-*.dist-info | sed 's/.*tilth-\(.*\).dist-info/\1/'; }
is() { test "$(version current)" = "$1"; }
brought() { rm -f /var/lib/tilth-updates/*; cp $OUT/$1/tilth_* /var/lib/tilth-updates/; }
look() { systemctl start tilth-update; systemctl start tilth-update; } # twice: the first sees that it has settled

if [ -n "$NEEDED" ]; then
    mkdir -p /usr/local/lib/needed /usr/local/lib/packages
    mount --bind "$NEEDED" /usr/local/lib/packages
    ln -s /usr/local/lib/packages/* /usr/local/lib/needed/
    (cd /usr/local/lib/needed && rm -rf tilth* __editable__* *.pth)
    export PIP_NO_DEPS=1 PYTHONPATH=/usr/local/lib/needed
fi
for unit in tilth tilth-update tilth-update-boot; do
    mkdir -p /etc/systemd/system/$unit.service.d
    printf '[Service]\nEnvironment=PIP_NO_DEPS=%s PYTHONPATH=%s\n' "$PIP_NO_DEPS" "$PYTHONPATH" \
        >/etc/systemd/system/$unit.service.d/needed.conf
done
cat >>/etc/systemd/system/tilth-update.service.d/needed.conf <<END
CPUSchedulingPolicy=other
Nice=0
ExecStart=
ExecStart=/opt/tilth/keeper/bin/python -P -c "from tilth.deploy import update; update.TRIAL_S = $TRIAL_S; raise SystemExit(update.main([]))"
END
mkdir -p /etc/tilth/update-keys /var/lib/tilth-updates
cp $OUT/ours.pub /etc/tilth/update-keys/

# Installed, and it records once it has a machine file; upgraded by hand, and back.
export DEBIAN_FRONTEND=noninteractive
dpkg --install $OUT/first/tilth_*.deb
if systemctl is-active tilth; then exit 1; fi
tilth-setup machine $OUT/machine.toml
records && is "$(basename $OUT/first/tilth_* | cut -d_ -f2 | cut -d- -f1)"
systemctl is-active tilth-update.timer
systemctl stop tilth-update.timer # the rest of this script says when
first=$(version current)
dpkg --install $OUT/second/tilth_*.deb
records && is 9.0.0
tilth-setup rollback
records && is "$first"

# With nobody present: prepared while it records; the next start applies it.
brought waits
look
is "$first" && test "$(version next)" = 9.1.0
systemctl stop tilth # the power is cut
systemctl start tilth-update-boot tilth
is 9.1.0 && test "$(version keeper)" = "$first"
systemctl start tilth-update
test "$(version keeper)" = 9.1.0
records

# At rest it is applied at once; what ends again and again, and what records nothing, is taken back.
tilth-setup machine $OUT/resting.toml
records
for one in crashes silent; do
    ready 120 "state | grep StatusText=ready" || true
    brought $one
    look
    is 9.1.0 && records
done
cat /opt/tilth/updates.json >$OUT/updates.json
test "$(ls /opt/tilth/releases | wc -l)" = 1
ready 60 'test "$(cat /var/lib/tilth/logs/.updates.told)" = "$(grep -o "\"id\": \"[0-9a-f]*" $OUT/updates.json | tail -n 1 | cut -d\" -f4)"'
systemctl stop tilth
mkdir $OUT/logs
cp /var/lib/tilth/logs/*.mcap $OUT/logs/

# Removed, purged: the logs stay.
apt-get -y remove tilth
test ! -e /opt/tilth && test ! -e /etc/systemd/system/tilth-update.timer && test -e /etc/tilth/machine.toml
apt-get -y purge tilth
test ! -e /etc/tilth && ls /var/lib/tilth/logs/*.mcap
