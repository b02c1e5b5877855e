# Run in the guest by test_priorities.py: the recorder's own unit, but for what it runs, which is priorities.py.
system=$CHECKOUT/deploy/system
mkdir -p /usr/local/lib/packages /etc/systemd/system/tilth.service.d /etc/sysusers.d
mount --bind "$NEEDED" /usr/local/lib/packages # where the recorder's user may read it
cp $system/tilth.service /etc/systemd/system/
cp $system/tilth.sysusers /etc/sysusers.d/tilth.conf
systemd-sysusers /etc/sysusers.d/tilth.conf
# Nothing is packaged for that processor, so something is compiled.
cat >/etc/systemd/system/tilth.service.d/other.conf <<END
[Service]
Type=oneshot
Restart=no
WatchdogSec=0
TimeoutStartSec=1500
Environment=PYTHONPATH=$CHECKOUT/.typing:/usr/local/lib/packages PYTHONDONTWRITEBYTECODE=1 NUMBA_CPU_NAME=x86-64-v2
ExecStart=
ExecStart=/usr/bin/python3 -P $CHECKOUT/tests/vm/priorities.py $CHECKOUT/deploy/machines/jd7930-parker500.toml
StandardOutput=truncate:/run/found.json
StandardError=truncate:/run/errors.txt
END
systemctl daemon-reload
systemctl start tilth || true
cp /run/found.json /run/errors.txt $OUT/
systemctl show tilth --property=Result,ExecMainStatus
