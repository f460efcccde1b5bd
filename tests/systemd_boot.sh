#!/bin/sh
# PID 1 of namespaces that are thrown away: an overlay of this machine's own files, fresh /proc,
# /sys, /dev, /run and /tmp, and systemd with our units alone. Started by systemd_machine.py as
#   unshare --mount --pid --fork --uts --ipc --net --cgroup --propagation private sh THIS SCRATCH CONSOLE
# SCRATCH/tree lies over the root. Nothing of it reaches the machine: what is mounted is mounted in
# the own mount namespace, and the cgroups are below the one that the caller has made.
set -eu
scratch=$1
console=$2
hostname throwaway
mount -t tmpfs -o mode=0755 tmpfs "$scratch/memory"
root=$scratch/memory/root
mkdir "$scratch/memory/upper" "$scratch/memory/work" "$root"
cp -a "$scratch/tree/." "$scratch/memory/upper/"
chmod 0755 "$scratch/memory/upper"
mount -t overlay overlay \
	-o "lowerdir=/,upperdir=$scratch/memory/upper,workdir=$scratch/memory/work" "$root"
mount -t proc proc "$root/proc"
mount -t sysfs sysfs "$root/sys"
mount -t tmpfs -o mode=0755 tmpfs "$root/sys/fs/cgroup" 2>/dev/null || true
mount -t cgroup2 cgroup2 "$root/sys/fs/cgroup"
mount -t tmpfs -o mode=0755 tmpfs "$root/run"
mount -t tmpfs -o mode=1777 tmpfs "$root/tmp"
mount -t tmpfs -o mode=0755 tmpfs "$root/dev"
for node in null zero full random urandom tty cpu_dma_latency; do
	test -e "/dev/$node" || continue
	touch "$root/dev/$node"
	mount --bind "/dev/$node" "$root/dev/$node"
done
touch "$root/dev/console"
mount --bind "$console" "$root/dev/console"
mkdir "$root/dev/pts" "$root/dev/shm" "$root/run/units"
mount -t devpts -o newinstance,ptmxmode=0666,mode=0620 devpts "$root/dev/pts"
ln -s pts/ptmx "$root/dev/ptmx"
mount -t tmpfs -o mode=1777 tmpfs "$root/dev/shm"
ln -s /proc/self/fd "$root/dev/fd"
cp "$scratch"/units/* "$root/run/units/"
while read -r from to; do
	mkdir -p "$root$to"
	mount --bind "$from" "$root$to"
done <"$scratch/binds"
# Without it a service's credentials are mounted where it does not see them.
mount --make-rshared "$root"
ip link set lo up
cd "$root"
exec chroot "$root" env -i container=unshare PATH=/usr/sbin:/usr/bin:/sbin:/bin \
	SYSTEMD_UNIT_PATH=/run/units:/etc/systemd/system SYSTEMD_LOG_TARGET=console \
	/lib/systemd/systemd --system --unit=test.target --log-level=info --show-status=no
