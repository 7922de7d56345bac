#!/bin/bash
# What a worker behind a thin link costs a job: the wall time of a normal worker alone, and of both together, at
# 1920 x 1080 and 1 Mbit/s each way. The far worker sits in a network namespace at the end of a virtual cable (ip, tc).
# Usage: bench_link.sh BUILD [SPP [TURNS [RATE [SCENE]]]]; as root, or where user namespaces are allowed. The turns
# alternate, and their times are summed, since the speed of a machine wanders. No verdict.
set -eu
if [ "${1:-}" != --separate ]; then
    exec unshare --net --mount --map-root-user "$0" --separate "$@"
fi
shift
build=$1 spp=${2:-6} turns=${3:-3} rate=${4:-1mbit} scene=${5:-scenes/seed-hidden}
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

# One job with a fresh master; $1: whether the far worker takes part. Adds to $total, milliseconds.
declare -A total=([alone]=0 [both]=0)
run() {
    local data=$folder/data begin took
    "$build/lightmill-master" --listen 0.0.0.0 --insecure --data "$data" 2>"$folder/$1.master" &
    local master=$! workers=()
    sleep 1
    "$build/lightmill-worker" --threads 1 --name normal --cache "$folder/cache" 2>/dev/null &
    workers+=($!)
    if [ "$1" = both ]; then
        nsenter --target "$site" --net "$build/lightmill-worker" 10.77.1.1 --insecure --threads 1 --name far \
            --cache "$folder/far" 2>"$folder/far.log" &
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
    rm -rf "$data"
    total[$1]=$((total[$1] + took))
    echo "$1: $((took / 1000)) s, pixels $("$build/lightmill" info --hash "$folder/$1.exr")"
}

for ((turn = 0; turn < turns; turn++)); do
    run alone
    run both
done
echo "with the far worker: $((100 * (total[both] - total[alone]) / total[alone])) % more time"
