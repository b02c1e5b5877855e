# Real SocketCAN under the daemon's own buses and log (bench/recorder.py: what is computed beside them would
# take minutes to start here). Who sends and who watches are can-utils. Run in the guest.
# $OUT/said.txt: what the recorder said; $OUT/*.candump: what candump saw; $OUT/times: when what was done.
did() { echo "$1 $(date +%s.%N)" >>$OUT/times; }
count() { grep -c -- "$1" $OUT/said.txt || true; }
said() { # wait until the recorder has said so (so many times)
    for _ in $(seq 6000); do
        [ "$(count "$1")" -ge "${2:-1}" ] && return
        sleep 0.1
    done
    echo "it has never said: $1" && cat $OUT/said.txt && exit 1
}
told() { said "^status.*$1" $(($(count "^status.*$1") + 1)); } # a status that is made from now on
sent() { cat /sys/class/net/$1/statistics/tx_packets; }

for i in 0 1 2 3; do ip link add vcan$i type vcan && ip link set vcan$i up; done
for i in 0 1; do
    ip link set can$i type can bitrate 250000 restart-ms 100 && ip link set can$i txqueuelen 1000 up
done
for name in vcan0 can0 can1; do candump -L -r 8000000 $name,0:0,#FFFFFFFF >$OUT/$name.candump & done
python bench/recorder.py record $OUT/machine.toml /run/logs >$OUT/said.txt 2>&1 &
recorder=$!
for name in vcan0 vcan1 vcan2 vcan3 can1; do # the first frames, until it has opened them
    until grep -q "$name: its frames are stamped by" $OUT/said.txt; do
        cansend $name 1F000000#00 && sleep 0.2
    done
done
said "can0: its frames are stamped by"

# what candump sees is what the log holds
cangen vcan0 -g 0 -n 3000 -I i -L i -D r -e
cangen vcan0 -g 0 -n 1000 -I r -L r -D r
canplayer -I $OUT/drive.log vcan0=vcan0
cangen can0 -g 2 -n 500 -I i -L 8 -D i -e -p 10

# the fourth bus has traffic all the time, whatever happens to the others
cangen vcan3 -g 20 -I 0ABCDEF0 -L 8 -D i -e &
steady=$!

# error frames: overrun, error-passive, bus-off and restarted
cansend vcan0 20000004#0001000000000000
cansend vcan0 20000004#0010000000000000
said "vcan0: overrun" && said "vcan0: error-passive" && told "| vcan0 [a-z]* passive"
cansend vcan0 20000040#0000000000000000
said "vcan0: bus-off" && told "| vcan0 [a-z]* bus_off: bus-off"
cansend vcan0 20000100#0000000000000000
said "vcan0: the controller was restarted"

# down and up
did down && ip link set vcan2 down && did downed
said "vcan2: socketcan vcan2: Network is down" && told "| vcan2 failed[^|]*Network is down"
did up && ip link set vcan2 up
until grep -q "vcan2: works again" $OUT/said.txt; do cansend vcan2 1F000001#00 && sleep 0.2; done

# deleted, with frames that the recorder has not yet read, and back
kill -STOP $recorder
cangen vcan2 -g 0 -n 50 -I 1F000010 -L 8 -D i -e
did delete && ip link del vcan2
kill -CONT $recorder && did deleted
said "vcan2: socketcan vcan2: No such device" && told "| vcan2 failed[^|]*No such device"
ip link add vcan2 type vcan && did back && ip link set vcan2 up
until [ "$(grep -c "vcan2: works again" $OUT/said.txt)" = 2 ]; do cansend vcan2 1F000002#00 && sleep 0.2; done

# a real controller goes down and comes back at once, before any status can tell
did pull && ip link set can1 down && did pulled && ip link set can1 up
said "can1: socketcan can1: Network is down"
until grep -q "can1: works again" $OUT/said.txt; do cansend can0 1F000003#00 && sleep 0.2; done

# silence of one that was heard
silences=$(count "vcan1: silent")
did silent && cansend vcan1 1F000004#00
said "vcan1: silent" $((silences + 1)) && told "| vcan1 silent"

# more than the kernel keeps, while the recorder stands still
before=$(sent vcan1)
kill -STOP $recorder
cangen vcan1 -g 0 -n 20000 -I 1FFFFF00 -L 8 -D i -e
kill -CONT $recorder
said "vcan1: .* frames lost in the kernel" && told "| vcan1"
echo "flood $(($(sent vcan1) - before))" >>$OUT/times

kill $steady && wait $steady || true
echo "steady $(sent vcan3)" >>$OUT/times
told "| vcan3" && kill -INT $recorder && wait $recorder
kill %1 %2 %3
cp /run/logs/*.mcap $OUT
