#!/usr/bin/env bash
# two_hosts.sh BIN: a pipeline on one host, and its bus and stream used from another one over tcp with keys. The hosts are
# network, process and mount namespaces with a cable between them. Exits with 77 where there can be none.
set -euo pipefail
bin="$(readlink -f "$1")"
if [ -z "${SPLATBUS_TWO_HOSTS:-}" ]; then
  for tool in ip unshare nsenter; do
    command -v "$tool" >/dev/null || { echo "skipped: there is no $tool" >&2; exit 77; }
  done
  unshare --net --mount --pid --fork --mount-proc ip link add cable type veth peer name other 2>/dev/null ||
    { echo "skipped: no namespaces, or no cables between them, are allowed here" >&2; exit 77; }
  exec env SPLATBUS_TWO_HOSTS=1 unshare --net --mount --pid --fork --mount-proc --kill-child "$0" "$bin"
fi

here=10.77.0.1
there=10.77.0.2
work="$(mktemp -d)"
keeper="" launched=""
clean_up() {
  if [ -n "$launched" ]; then
    kill "$launched" 2>/dev/null || true
    timeout 20 tail --pid="$launched" -f /dev/null || true  # it stops its services first
  fi
  kill -KILL "$keeper" $(jobs -p) 2>/dev/null || true  # which unshare does not do for a signal
  wait || true
  rm -rf "$work" || true
}
trap clean_up EXIT
unset SPLATBUS_BUS SPLATBUS_KEY SPLATBUS_SERVER_KEY
export XDG_STATE_HOME="$work/state" XDG_RUNTIME_DIR="$work/run" SPLATBUS_KEYS="$work/keys"
mkdir -m 700 "$work/run" "$work/away"

# The other host: nothing of this one's memory, processes or sockets is there.
unshare --net --mount --pid --fork --mount-proc --kill-child sh -c 'mount -t tmpfs shm /dev/shm; exec sleep infinity' &
keeper=$!
away=""
for _ in $(seq 100); do
  away="$(cat "/proc/$keeper/task/$keeper/children" 2>/dev/null || true)"
  away="${away%% *}"
  [ -n "$away" ] && [ "$(readlink "/proc/$away/ns/net")" != "$(readlink /proc/self/ns/net)" ] && break
  sleep 0.05
done
if [ -z "$away" ] || ! nsenter --target "$away" --net --mount --pid -- true 2>/dev/null; then
  echo "skipped: no second host can be entered here" >&2
  exit 77
fi
ip link set lo up
ip link add cable type veth peer name cable netns "$away"
ip addr add "$here/24" dev cable
ip link set cable up
elsewhere() {
  nsenter --target "$away" --net --mount --pid -- \
    env SPLATBUS_KEYS="$work/away" XDG_RUNTIME_DIR="$work/away" XDG_STATE_HOME="$work/away" "$@"
}
elsewhere ip link set lo up
elsewhere ip addr add "$there/24" dev cable
elsewhere ip link set cable up

fail() { echo "two_hosts: $*" >&2; tail -n 40 "$work"/*.log >&2; exit 1; }
# Until a command succeeds, so many times.
until_it() {
  local times="$1"
  shift
  for _ in $(seq "$times"); do
    "$@" >"$work/tried.log" 2>&1 && return
    sleep 0.5
  done
  fail "after $times times: $*"
}

# Each host makes its own keys; public ones go from one to the other.
public_key() { sed -n 's/^public = //p' "$1"; }
"$bin/splatbus" keys new server >/dev/null
elsewhere "$bin/splatbus" keys new guest >/dev/null
elsewhere "$bin/splatbus" keys new stranger >/dev/null
elsewhere "$bin/splatbus" keys new replica >/dev/null
elsewhere "$bin/splatbus" keys new server >/dev/null
guest="$(public_key "$work/away/guest.key")"
"$bin/splatbus" keys allow "$guest" --name guest --role view >/dev/null
"$bin/splatbus" keys allow "$(public_key "$work/away/replica.key")" --name replica --role view --role control >/dev/null
elsewhere "$bin/splatbus" keys allow "$guest" --name guest --role view >/dev/null
server="$(public_key "$work/keys/server.key")"

cat >"$work/here.yaml" <<YAML
services:
  - {name: bus, args: [--tcp, "$here:7555"]}
  - {name: engine, program: splatbus-engine-sim}
  - {name: capture-bridge, parameters: {input_cameras: 8, input_size: 64, sample_budget: 4000, reference_cameras: 4, reference_size: 64}}
  - name: expander
  - name: trainer
  - name: relight
  - {name: streamer, parameters: {tcp: "tcp://$here:7600"}}
YAML
"$bin/splatbus" launch "$work/here.yaml" >"$work/launch.log" 2>&1 &
launched=$!
until_it 60 "$bin/splatbus" health streamer

topic() {  # KEY SECONDS TOPIC: one message, read on the other host
  elsewhere "$bin/splatbus" topic echo "$3" --once --seconds "$2" --bus "tcp://$here:7555" --key "$work/away/$1.key" \
    --server-key "$server"
}
until_it 20 topic guest 5 trainer/stats
if topic stranger 3 trainer/stats >"$work/stranger.log" 2>&1; then fail "a key that nobody allowed reads the bus"; fi
if elsewhere "$bin/splatbus" topic echo trainer/stats --once --seconds 3 --bus "tcp://$here:7555" >"$work/bare.log" 2>&1; then
  fail "the bus is read without a key"
fi

# A viewer there, which goes on until it is told to end.
pictures() {  # KEY ENDPOINT SERVER FOLDER: of ten seconds
  elsewhere timeout 10 "$bin/splatbus-viewer" --connect "$2" --key "$work/away/$1.key" --server-key "$3" \
    --backend cpu --set out="$work/away/$4" --set frames=10 --set fps=10 --set width=96 --set height=96 || true
}
is_picture() {
  local newest
  newest="$(find "$work/away/$1" -name '*.png' 2>/dev/null | sort | tail -n 1)"
  [ -n "$newest" ] && [ "$(stat -c %s "$newest")" -gt 4000 ]
}
shows() {  # as pictures(): some of several times ten seconds show a model
  for _ in $(seq 6); do
    pictures "$@" >"$work/viewer_$4.log" 2>&1
    if is_picture "$4"; then return; fi
  done
  fail "a viewer of $2 shows nothing"
}
shows guest "tcp://$here:7600" "$server" from_here
pictures stranger "tcp://$here:7600" "$server" strange >"$work/strange.log" 2>&1
if is_picture strange; then fail "a key that nobody allowed is sent the stream"; fi

# A streamer there: it reads the model over the bus, and serves viewers of its own host.
elsewhere "$bin/splatbus-streamer" --bus "tcp://$here:7555" --name far --key "$work/away/replica.key" --server-key "$server" \
  --set endpoint="tcp://$there:7601" >"$work/far.log" 2>&1 &
until_it 60 "$bin/splatbus" health far
far_server="$(public_key "$work/away/server.key")"
shows guest "tcp://$there:7601" "$far_server" from_there

# Who is no longer allowed is out at once.
"$bin/splatbus" keys revoke guest >/dev/null
if topic guest 3 trainer/stats >"$work/revoked.log" 2>&1; then fail "a revoked key reads the bus"; fi
if [ -n "${SPLATBUS_TWO_HOSTS_PICTURES:-}" ]; then cp -r "$work/away/from_here" "$work/away/from_there" "$SPLATBUS_TWO_HOSTS_PICTURES"; fi
echo "two_hosts: ok"
