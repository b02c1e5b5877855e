# Run by contained.py in namespaces of its own: a root under a file system in memory, or on the first partition of the
# image $UPPER, then with_systemd.sh there.
mount --make-rprivate /
root=$(mktemp -d)
mount -t tmpfs -o size=8g memory "$root"
mkdir "$root/upper" "$root/root" "$root/groups"
[ -z "$UPPER" ] || mount -t ext4 -o "loop,offset=$((2048 * 512))" "$UPPER" "$root/upper"
mkdir -p "$root/upper/files" "$root/upper/work"
# A control group of its own, which systemd takes for the first.
mount -t cgroup2 none "$root/groups"
group="$root/groups/tilth-contained-$(od -An -N4 -tx4 /dev/urandom | tr -d ' ')"
mkdir "$group"
emptied() { find "$group" -depth -type d -exec rmdir {} + 2>/dev/null; [ ! -e "$group" ]; }
trap 'echo 1 >"$group/cgroup.kill"; until emptied; do sleep 0.1; done' EXIT
mount -t overlay -o "lowerdir=/,upperdir=$root/upper/files,workdir=$root/upper/work" overlay "$root/root"
cd "$root/root"
mount -t proc proc proc
mount -t sysfs -o ro sys sys
mount -t tmpfs -o mode=755 dev dev
for name in null zero full random urandom tty; do touch dev/$name && mount --bind /dev/$name dev/$name; done
mkdir dev/shm dev/pts
ln -s /proc/self/fd dev/fd
for place in dev/shm run tmp; do mount -t tmpfs memory $place; done
here=$(dirname "$(readlink -f "$0")")
for place in "$OUT" "${here%/tests/vm}"; do # of which the second may be below /tmp, too
    mkdir -p "./$place"
    mount --bind "$place" "./$place"
done
ip link set lo up
(echo 0 >"$group/cgroup.procs" && exec unshare --cgroup chroot . bash -e "$here/with_systemd.sh" "$@")
