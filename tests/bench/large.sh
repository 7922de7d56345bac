#!/bin/bash
# A farm of one master and one worker on this machine renders a large image for a while, and two people fetch it at once,
# again and again. Says how far apart checkpoints were, from the start of the worker on, how long fetches took, what
# snapshots took on the disk, and how much memory the master needed, in films. Ends with 1 when a checkpoint came later
# than LIMIT, a fetch failed, or the master needed more than five films.
#
# usage: tests/bench/large.sh [BUILD]
#   SIZE=7680x4320    SECONDS_TO_RUN=420    LIMIT=120 (seconds)    SCENE=scenes/seed-diffuse    THREADS=  (of the worker)
#   LAYERS=--no-layers; LAYERS= renders with the layers of what is seen, whose film is twice as large
set -eu
build=${1:-build}
size=${SIZE:-7680x4320} seconds=${SECONDS_TO_RUN:-420} limit=${LIMIT:-120} scene=${SCENE:-scenes/seed-diffuse}
layers=${LAYERS---no-layers}
folder=$(mktemp -d)
log=$folder/master.log
master='' worker=''

finish() {
    [ -z "$worker" ] || kill -9 "$worker" 2>/dev/null || true
    [ -z "$master" ] || kill -9 "$master" 2>/dev/null || true
    wait
    rm -rf "$folder"
}
trap finish EXIT

# Seconds since the worker began, with one digit.
elapsed() {
    awk -v a="$begin" -v b="$(date +%s.%N)" 'BEGIN { printf "%.1f", b - a }'
}

# last_checkpoint: the number of the last one, 0 for none.
last_checkpoint() {
    find "$folder/data/films" -name 'job-1.*.film' 2>/dev/null | sed -E 's/.*job-1\.([0-9]+)\.film/\1/' | sort -n | tail -1 | grep . || echo 0
}

# fetch NUMBER: fetches the image once, and writes down how long it took, or why it failed.
fetch() {
    local start
    start=$(elapsed)
    if "$build/lightmill" fetch 1 --master "127.0.0.1:$port" -o "$folder/$1.exr" >"$folder/fetch-$1.log" 2>&1; then
        echo "$start $(elapsed) $(stat -c %s "$folder/$1.exr")" >>"$folder/fetches"
        cp "$folder/fetch-$1.log" "$folder/fetch.log"
    elif kill -0 "$master" 2>/dev/null; then
        echo "fetch from $start s: $(tail -1 "$folder/fetch-$1.log")" >>"$folder/failures"
    fi
}

# Two at a time, the second a little later.
fetch_all() {
    sleep 40
    while kill -0 "$master" 2>/dev/null; do
        fetch 1 &
        sleep 5
        fetch 2
        wait
        sleep 30
    done
}

port=$((20000 + RANDOM % 20000))
"$build/lightmill-master" --listen "127.0.0.1:$port" --data "$folder/data" --checkpoint-max "$limit" >"$log" 2>&1 &
master=$!
for _ in $(seq 100); do "$build/lightmill" status --master "127.0.0.1:$port" >/dev/null 2>&1 && break; sleep 0.1; done
# shellcheck disable=SC2086 # LAYERS may be nothing
"$build/lightmill" submit "$scene" --master "127.0.0.1:$port" --resolution "$size" --spp 100000 $layers --quiet >/dev/null
begin=$(date +%s.%N)
"$build/lightmill-worker" "127.0.0.1:$port" --cache "$folder/cache" ${THREADS:+--threads "$THREADS"} >"$folder/worker.log" 2>&1 &
worker=$!
fetch_all &

echo 0 >"$folder/times"
number=0
while awk -v t="$(elapsed)" -v s="$seconds" 'BEGIN { exit !(t < s) }'; do
    kill -0 "$master" || { tail "$log"; exit 1; }
    now=$(last_checkpoint)
    [ "$now" = "$number" ] || { number=$now; elapsed >>"$folder/times"; echo >>"$folder/times"; }
    awk '/VmHWM/ { print $2 * 1024 }' "/proc/$master/status" >"$folder/memory"
    du -sb "$folder/data/snapshots" | cut -f1 >>"$folder/snapshots"
    sleep 0.5
done
elapsed >>"$folder/times"
"$build/lightmill" status 1 --master "127.0.0.1:$port" | head -5
{
    kill -9 "$master" "$worker"
    wait
} 2>/dev/null
master='' worker=''

echo "checkpoints after $(sed 1d "$folder/times" | sed '$d' | grep . | tr '\n' ' ')s"
[ ! -e "$folder/fetch.log" ] || grep -m 3 "the master is writing" "$folder/fetch.log" || true
awk 'NF { if ($1 - last > most) most = $1 - last; last = $1 } END { printf "the longest time without one: %.1f s\n", most }' "$folder/times"
[ ! -e "$folder/fetches" ] ||
    awk '{ printf "fetch from %.1f s: %.1f s, %.0f MB\n", $1, $2 - $1, $3 / 1e6 }' "$folder/fetches"
awk '$1 > most { most = $1 } END { printf "snapshots took %.2f GB of the disk at most\n", most / 1e9 }' "$folder/snapshots"
film=$(awk -v size="$size" -v layers="$layers" 'BEGIN { split(size, s, "x"); printf "%.0f", s[1] * s[2] * (layers == "" ? 212 : 100) }')
awk -v film="$film" '{ printf "the master took %.2f GB at most: %.2f films of %.2f GB\n", $1 / 1e9, $1 / film, film / 1e9 }' "$folder/memory"
[ ! -e "$folder/failures" ] || cat "$folder/failures"
[ -e "$folder/fetches" ] && [ ! -e "$folder/failures" ]
awk -v limit="$limit" 'NF { if ($1 - last > limit) bad = 1; last = $1 } END { exit bad }' "$folder/times"
awk -v film="$film" '{ exit !($1 < 5 * film) }' "$folder/memory"
