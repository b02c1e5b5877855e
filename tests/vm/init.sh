#!/bin/busybox sh
# First process of the guest: this computer's own root, read-only, under a file system in memory, or on the drive
# that the kernel was told of: upper=/dev/vda.
b=/bin/busybox
$b mount -t proc proc /proc
$b mount -t sysfs sys /sys
$b mount -t devtmpfs dev /dev
while read -r module; do
    $b insmod "/modules/$module" || echo "no module $module"
done </modules/order
$b mount -t 9p -o trans=virtio,version=9p2000.L,msize=1048576,cache=loose,ro root /lower
if [ -n "$upper" ]; then $b mount -t ext4 "$upper" /upper; else $b mount -t tmpfs memory /upper; fi
$b mkdir -p /upper/files /upper/work
$b mount -t overlay -o lowerdir=/lower,upperdir=/upper/files,workdir=/upper/work overlay /root
for name in proc sys dev; do
    $b mount --move /$name /root/$name
done
$b mkdir -p /root/dev/pts /root/dev/shm /root/mnt/out
$b mount -t devpts devpts /root/dev/pts
$b mount -t tmpfs memory /root/dev/shm
$b mount -t tmpfs memory /root/run
$b mount -t 9p -o trans=virtio,version=9p2000.L,msize=262144,cache=none out /root/mnt/out
exec $b chroot /root /bin/bash /mnt/out/.run.sh
