# The recorder, candump and python-can's own logger beside each other on one vcan, at a rate that all of them
# can follow here. $OUT/cpu: name, ticks of CPU, frames in the log. Run in the guest.
cpu() { awk '{print $14 + $15}' /proc/$1/stat; }
echo 8000000 >/proc/sys/net/core/rmem_default # none of them loses a frame where the computer is busy
ip link add vcan0 type vcan && ip link set vcan0 up
candump -L vcan0 >/run/candump.log &
candump=$!
# python -m can.logger, without the minute that asammdf would take to load here, and with the SIGINT that bash takes
# from what it starts in the background
python -c 'import signal, sys; sys.modules["asammdf"] = None; from can.logger import main
signal.signal(signal.SIGINT, signal.default_int_handler); main()' \
    -i socketcan -c vcan0 -f /run/library.log >$OUT/library.txt 2>&1 &
library=$!
python bench/recorder.py record $OUT/machine.toml /run/logs >$OUT/said.txt 2>&1 &
tilth=$!
for _ in $(seq 1500); do # until all three listen
    cat /proc/net/can/rcvlist_all >$OUT/listening.txt
    [ "$(grep -c vcan0 $OUT/listening.txt)" -lt 3 ] || break
    sleep 0.2
done
for name in candump library tilth; do eval "before_$name=$(cpu ${!name})"; done
cangen vcan0 -g 2 -n 4000 -e -I r -L 8 -D r
sleep 2
for name in candump library tilth; do eval "after_$name=$(cpu ${!name})"; done
kill -INT $tilth $library && wait $tilth $library || true
kill $candump
frames=$(sed -n 's/.*"frames": \([0-9]*\).*/\1/p' $OUT/said.txt)
echo "tilth $((after_tilth - before_tilth)) $frames" >$OUT/cpu
echo "candump $((after_candump - before_candump)) $(wc -l </run/candump.log)" >>$OUT/cpu
echo "can.logger $((after_library - before_library)) $(wc -l </run/library.log)" >>$OUT/cpu
