# Run under a systemd of its own by test_upgrade_cut.py: upgrade.sh installed, cut or started. $OUT has machine.toml
# and the packages old.deb and new.deb, of Tilth alone; $NEEDED: what it needs; $PORT: of its bus.
PS4='+ ${SECONDS} s: '
ready() { for _ in $(seq "$1"); do if eval "$2"; then return 0; fi; sleep 0.5; done; return 1; }
records() { ready 600 "systemctl show tilth --property=StatusText | grep -E 'StatusText=(recording|ready)'"; }
upgrade() { dpkg --install $OUT/new.deb; }
# Where the recorder's user may read it; a start of the machine forgets it.
mkdir -p /usr/local/lib/packages
mount --bind "$NEEDED" /usr/local/lib/packages
export DEBIAN_FRONTEND=noninteractive PIP_NO_DEPS=1 PIP_NO_COMPILE=1 PYTHONPATH=/usr/local/lib/needed NUMBA_DISABLE_JIT=1

case "$1" in
installed) # the old release, which has recorded
    mkdir -p /usr/local/lib/needed
    ln -s /usr/local/lib/packages/* /usr/local/lib/needed/
    (cd /usr/local/lib/needed && rm -rf tilth* __editable__* *.pth)
    for unit in tilth tilth-update tilth-update-boot; do
        mkdir /etc/systemd/system/$unit.service.d
        printf '[Service]\nEnvironment=PYTHONPATH=%s NUMBA_DISABLE_JIT=1\nTimeoutStartSec=600\n' $PYTHONPATH \
            >/etc/systemd/system/$unit.service.d/needed.conf
    done
    dpkg --install $OUT/old.deb
    tilth-setup machine $OUT/machine.toml
    records
    systemctl stop tilth
    mkdir -p $OUT/logs && cp /var/lib/tilth/logs/*.mcap $OUT/logs/
    ;;
cut) # upgraded while it records frames
    ip route add 239.0.0.0/8 dev lo
    systemctl start tilth
    records
    python3 "$(dirname "$0")/numbered_frames.py" $PORT $OUT/sent &
    ready 600 "systemctl show tilth --property=StatusText | grep -E ' [0-9]{2,} frames'"
    touch $OUT/begun
    upgrade
    records
    touch $OUT/ended
    ;;
started) # after the cut, by what the installer has enabled
    systemctl start tilth-update-boot tilth
    records
    readlink -f /opt/tilth/current/lib/python3*/site-packages/tilth-*.dist-info >$OUT/current
    cp -r "$(readlink -f /opt/tilth/current)"/lib/python3*/site-packages $OUT/release
    systemctl stop tilth
    mkdir $OUT/logs && cp /var/lib/tilth/logs/*.mcap $OUT/logs/
    if [ "$2" = again ]; then
        dpkg --configure -a || true
        upgrade
        records
        readlink -f /opt/tilth/current/lib/python3*/site-packages/tilth-*.dist-info >$OUT/again
    fi
    ;;
esac
