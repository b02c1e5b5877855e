# Run in mounts and a network of its own by test_container.py: here are compose.yaml, machine.toml and the
# scenario drive.toml. $PYTHON runs Tilth beside the containers.
tilth() { "$PYTHON" -m tilth.cli "$@"; }
ready() { for _ in $(seq "$1"); do if "$2" "${@:3}"; then return 0; fi; sleep 1; done; return 1; }
mount --make-rprivate /
umount -R /sys/fs/cgroup && mount -t cgroup2 none /sys/fs/cgroup
ip link set lo up multicast on
ip route add 239.0.0.0/8 dev lo

tilth keys keys --machine machine.toml --host 127.0.0.1 --router --reader rita
chgrp 990 keys/daemon.json && chmod 640 keys/daemon.json
trap 'podman-compose logs >logs.txt 2>&1; podman-compose down --volumes' EXIT
podman-compose up --detach
container=$(podman ps --quiet --filter name=recorder)
ready 120 podman healthcheck run "$container"
ready 120 tilth keys --try keys/rita.json
tilth simulate drive.toml --bus udp_multicast:239.74.163.2,hop_limit=0 2>&1 | tee sent.txt
podman inspect "$container" --format '{{.HostConfig.ReadonlyRootfs}} {{.Config.User}} {{.EffectiveCaps}}' | grep 'true tilth \[\]'
"$PYTHON" -c "import urllib.request; print(urllib.request.urlopen('http://127.0.0.1:8117/').read(200))"
podman-compose stop
if podman run --rm --entrypoint python3 tilth -c 'open("/opt/tilth/x", "w")'; then exit 1; fi
cp "$(podman volume inspect --format '{{.Mountpoint}}' "$(podman volume ls --quiet --filter name=logs)")"/logs/*.mcap .
