#!/bin/bash
# What a worker behind a thin link costs a job: the wall time of a normal worker alone, and of both together, at
# 1920 x 1080 and 1 Mbit/s each way. The far worker sits in a network namespace at the end of a virtual cable (ip, tc).
# Usage: bench_link.sh BUILD [SPP [RATE [SCENE]]]; as root, or where user namespaces are allowed. No verdict.
set -eu
if [ "${1:-}" != --separate ]; then
    exec unshare --net --mount --map-root-user "$0" --separate "$@"
fi
shift
build=$1 spp=${2:-6} rate=${3:-1mbit} scene=${4:-scenes/seed-hidden}
folder=$(mktemp -d)
trap 'kill $(jobs -p) 2>/dev/null; wait; rm -rf "$folder"' EXIT

ip link set lo up
unshare --net sleep infinity &
site=$!
far() { nsenter --target "$site" --net "$@"; }
until [ "$(readlink "/proc/$site/ns/net")" != "$(readlink /proc/self/ns/net)" ]; do sleep 0.05; done
ip link add near type veth peer name far netns "$site"
ip addr add 10.77.1.1/24 dev near
ip link set near up
far ip addr add 10.77.1.2/24 dev far
far ip link set far up
tc qdisc add dev near root tbf rate "$rate" burst 16kb latency 300ms
far tc qdisc add dev far root tbf rate "$rate" burst 16kb latency 300ms

# One job with a fresh master; $1: whether the far worker takes part. Sets $took, milliseconds.
run() {
    local data=$folder/$1 begin
    "$build/lightmill-master" --listen 0.0.0.0 --insecure --data "$data" 2>"$folder/$1.master" &
    local master=$! workers=()
    sleep 1
    "$build/lightmill-worker" --threads 1 --name normal --cache "$folder/cache" 2>/dev/null &
    workers+=($!)
    if [ "$1" = both ]; then
        far "$build/lightmill-worker" 10.77.1.1 --insecure --threads 1 --name far --cache "$folder/far" \
            2>"$folder/far.log" &
        workers+=($!)
    fi
    sleep 2
    begin=$(date +%s%3N)
    "$build/lightmill" submit "$scene" --resolution 1920x1080 --spp "$spp" --wait --quiet -o "$folder/$1.exr"
    took=$(($(date +%s%3N) - begin))
    "$build/lightmill" status --workers | sed -n '/^worker/,$p'
    kill "${workers[@]}"
    wait "${workers[@]}" || true
    kill "$master"
    wait "$master" || true
    echo "$1: $((took / 1000)) s, pixels $("$build/lightmill" info --hash "$folder/$1.exr")"
}

run alone
alone=$took
run both
echo "with the far worker: $((100 * (took - alone) / alone)) % more time"
