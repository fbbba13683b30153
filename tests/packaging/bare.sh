# Sourced by who tries something in a bare Debian 12: makes one in $root, takes it down again when the script ends, and gives
# within(), which runs a command there. `run`: a process that is to end before. Needs root, debootstrap and the network.
root="$(mktemp -d)"
chmod 755 "$root"
within() { chroot "$root" env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/root DEBIAN_FRONTEND=noninteractive ${ca:+NODE_EXTRA_CA_CERTS=$ca} "$@"; }
clean() {
  local link pid
  [ -z "${run:-}" ] || { kill "$run" 2>/dev/null || true; wait "$run" 2>/dev/null || true; }
  for link in /proc/[0-9]*/root; do  # what it has started, and told to end
    [ "$(readlink "$link" 2>/dev/null)" = "$root" ] || continue
    pid="${link//[!0-9]/}"
    timeout 20 tail --pid="$pid" -f /dev/null || kill -KILL "$pid" 2>/dev/null || true
  done
  umount -l "$root"/{dev/shm,dev,proc} 2>/dev/null || true
  mountpoint -q "$root/dev" || rm -rf --one-file-system "$root"
}
trap clean EXIT
debootstrap --variant=minbase bookworm "$root" >/dev/null
# Where this machine reaches Debian and npm by a way of its own, so does the bare one.
cp -r /etc/apt/apt.conf.d "$root/etc/apt/"
[ ! -e "$HOME/.npmrc" ] || cp "$HOME/.npmrc" "$root/root/"
ca="${NODE_EXTRA_CA_CERTS:+/usr/local/share/ca.crt}"
[ -z "$ca" ] || cp "$NODE_EXTRA_CA_CERTS" "$root$ca"
mount -t proc proc "$root/proc"; mount --bind /dev "$root/dev"; mount --bind /dev/shm "$root/dev/shm"
within apt-get update -qq
