# Run in the guest by test_hotspot.py. $PACKAGES: a folder with NetworkManager and the rest.
PS4='+ ${SECONDS} s: '
ready() { for _ in $(seq "$1"); do if eval "$2"; then return 0; fi; sleep 1; done; return 1; }
cp -a "$PACKAGES/etc/." /etc/
cp -a "$PACKAGES/var/." /var/
mount -t overlay -o "lowerdir=$PACKAGES/usr:/usr" overlay /usr

# The computer: the profile of `tilth-setup phone`, brought up by the words of tilth-hotspot.service; the page.
python -P -m tilth.deploy.phone $OUT/label.toml --hotspot
told() { sed -n "s/^$1 = \"\(.*\)\".*/\1/p" $OUT/label.toml; }
tilth setup /run/machine.toml --label $OUT/label.toml --host 0.0.0.0 >$OUT/page.txt 2>&1 &
mkdir -p /run/dbus
dbus-daemon --system --fork
mount -o remount,ro /sys # NetworkManager waits for udev else, which is not here
unshare --net sleep infinity &
phone=$!
ready 60 '[ "$(readlink /proc/$phone/ns/net)" != "$(readlink /proc/self/ns/net)" ]'
iw phy phy1 set netns $phone
wpa_supplicant -B -u # as its unit does
NetworkManager
ready 120 'nmcli --terse --fields DEVICE,STATE device | grep "wlan0:disconnected"'
eval "$(sed -n 's/^Exec[A-Za-z]*=//p' deploy/system/tilth-hotspot.service)"
ip -brief address show dev wlan0 | grep -w 10.42.0.1/24

# The phone, in a network of its own: it hears the other radio only.
on_phone() { nsenter --net --target $phone "$@"; }
join() {
    printf 'ctrl_interface=/run/phone\nnetwork={\n ssid="%s"\n psk="%s"\n}\n' "$(told network)" "$1" >/run/phone.conf
    on_phone wpa_supplicant -B -i wlan1 -c /run/phone.conf -f "$OUT/$2.txt"
    ready "$3" 'on_phone wpa_cli -p /run/phone -i wlan1 status | grep wpa_state=COMPLETED'
}
if join wrong-passphrase stranger 20; then exit 1; fi
grep -E 'WRONG_KEY|pre-shared key may be incorrect' $OUT/stranger.txt
on_phone wpa_cli -p /run/phone -i wlan1 terminate
join "$(told passphrase)" phone 60
on_phone wpa_cli -p /run/phone -i wlan1 status | grep key_mgmt=WPA2-PSK
printf '#!/bin/sh\n[ "$1" != bound ] || ip addr add $ip/$mask dev $interface\n' >/run/lease.sh
chmod +x /run/lease.sh
on_phone busybox udhcpc -i wlan1 -n -q -s /run/lease.sh
page=http://10.42.0.1:8117
get() { on_phone curl --silent --cookie /run/jar --cookie-jar /run/jar --write-out '%{http_code}\n' "$@"; }
ready 300 "get $page/ --output $OUT/before"
get $page/setup/heard --output /dev/null | grep 403
get $page/enter --header "Origin: $page" --data-urlencode code=WRNG-C0DE --output /dev/null | grep 401
ready 5 'get $page/enter --header "Origin: $page" --data-urlencode "code=$(told code)" --output /dev/null | grep 303'
get $page/setup --output $OUT/after | grep 200
get $page/setup/heard --output $OUT/heard | grep 200
