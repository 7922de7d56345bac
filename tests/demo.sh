#!/bin/bash
# The demonstration: a real farm on this machine, one master and two workers that speak over loopback TCP, renders
# seed-hidden, a room lit only indirectly. Leaves seed-hidden.exr and seed-hidden.png.
#
# usage: tests/demo.sh BUILD_DIR OUTPUT_DIR
set -euo pipefail
build=$1 out=$2
here=$(cd "$(dirname "$0")/.." && pwd)
mkdir -p "$out"
work=$(mktemp -d)
jobs_started=()
finish() {
    [ ${#jobs_started[@]} = 0 ] || kill "${jobs_started[@]}" 2>/dev/null || true
    wait
    rm -rf "$work"
}
trap finish EXIT

"$build"/lightmill-master --listen 127.0.0.1:0 --data "$work/master" --batch-interval 1 2>"$out/master.log" &
jobs_started+=($!)
port=
for _ in $(seq 100); do
    port=$(sed -n 's/.*listening on tcp:\/\/127\.0\.0\.1:\([0-9]*\).*/\1/p' "$out/master.log" | head -n 1)
    [ -z "$port" ] || break
    sleep 0.05
done
[ -n "$port" ] || { echo "the master did not start:"; cat "$out/master.log"; exit 1; }
echo "lightmill-master listens on 127.0.0.1:$port (log: $out/master.log)"

threads=$((($(nproc) + 1) / 2))
for i in 1 2; do
    "$build"/lightmill-worker "127.0.0.1:$port" --name "$i" --threads $threads --cache "$work/cache" \
        2>"$out/worker-$i.log" &
    jobs_started+=($!)
    echo "lightmill-worker $i renders with $threads thread(s) (log: $out/worker-$i.log)"
done

"$build"/lightmill submit "$here/scenes/seed-hidden" --master "127.0.0.1:$port" --resolution 512x512 --spp 64 \
    --wait -o "$out/seed-hidden.exr" --png "$out/seed-hidden.png"
