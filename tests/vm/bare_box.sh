# Run in the guest by test_bare_box.py: $OUT has the wheels and the machine file, $NEEDED what Tilth needs,
# $CHECKOUT the installer.
ready() { for _ in $(seq "$1"); do if eval "$2"; then return 0; fi; sleep 1; done; return 1; }
state() { systemctl show tilth --property=ActiveState,NRestarts,StatusText,MainPID,User | tee -a $OUT/states; }

# What pip would fetch, where the recorder's user may read it, without the checkout.
mkdir -p /usr/local/lib/needed /usr/local/lib/packages
mount --bind "$NEEDED" /usr/local/lib/packages
ln -s /usr/local/lib/packages/* /usr/local/lib/needed/
(cd /usr/local/lib/needed && rm -rf tilth* __editable__* *.pth)
# Minutes to load here, and of no use: what reads other people's files, what compiles.
(cd /usr/local/lib/needed && rm -rf asammdf* numba* llvmlite* matplotlib* pandas*)
export PIP_NO_DEPS=1 PYTHONPATH=/usr/local/lib/needed
mkdir -p /etc/systemd/system/tilth.service.d
printf '[Service]\nEnvironment=PYTHONPATH=%s\nTimeoutStartSec=600\nWatchdogSec=20\nTimeoutAbortSec=2\n' \
    $PYTHONPATH >/etc/systemd/system/tilth.service.d/slow.conf
mkdir /tmp/setup
cp "$CHECKOUT/deploy/install.py" /tmp/setup/
cd /tmp/setup

/usr/bin/python3 install.py install $OUT/good/$WHEEL --machine $OUT/machine.toml
ready 60 'ip -d link show can0 | grep "bitrate 250000"'
systemctl show multi-user.target --property=Wants | grep -w tilth.service # at each boot
ip link set can1 up type can bitrate 250000
state
test "$(stat -c %U /var/lib/tilth/logs /var/cache/tilth | uniq)" = tilth
cangen can1 -g 50 -n 20 -I 123 -D 1122 -L 2
ready 60 "state | grep ' 20 frames'"

# A loop that hangs is noticed, and another begins.
kill -STOP "$(systemctl show tilth --property=MainPID --value)"
ready 240 "state | grep NRestarts=1"
ready 240 "state | grep ActiveState=active"

# A release that does not start is taken back.
if tilth-setup upgrade $OUT/bad/$WHEEL; then exit 1; fi
ready 240 "state | grep ActiveState=active"
readlink /opt/tilth/current >$OUT/current
tilth-setup rollback
ready 240 "state | grep ActiveState=active"
tilth-setup uninstall
ls /var/lib/tilth/logs >$OUT/logs
cp /var/lib/tilth/logs/*_001.mcap $OUT/
