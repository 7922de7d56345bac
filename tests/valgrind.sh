#!/bin/bash
# A master under valgrind serves 50 small jobs with two real workers, some of them extended, cancelled, fetched or
# deleted, and ends with SIGTERM: nothing that it allocated may be left, and it may not have touched what is not its
# own.
#
# usage: tests/valgrind.sh BUILD_DIR
set -euo pipefail
build=$1
jobs=50
limit=900 # seconds
work=$(mktemp -d)
running=()
finish() {
    code=$?
    [ ${#running[@]} = 0 ] || kill -9 "${running[@]}" 2>/dev/null || true
    wait 2>/dev/null || true
    if [ "$code" = 0 ]; then rm -rf "$work"; else echo "valgrind.sh failed; its files are in $work"; fi
}
trap finish EXIT

valgrind --quiet --leak-check=full --show-leak-kinds=all --errors-for-leak-kinds=all --error-exitcode=99 \
    --num-callers=30 --log-file="$work/valgrind.log" \
    "$build/lightmill-master" --listen 127.0.0.1:0 --data "$work/data" --lease 60 --batch-interval 0.5 --checkpoint 0.5 \
    2>"$work/master.log" &
master=$!
running+=("$master")
port=
for _ in $(seq 600); do
    port=$(sed -n 's/.*listening on tcp:\/\/127\.0\.0\.1:\([0-9]*\).*/\1/p' "$work/master.log" | head -n 1)
    [ -z "$port" ] || break
    sleep 0.1
done
[ -n "$port" ] || { echo "the master did not start:"; cat "$work/master.log"; exit 1; }
address=(--master "127.0.0.1:$port" --timeout 60)
for i in 1 2; do
    "$build/lightmill-worker" "127.0.0.1:$port" --threads 1 --cache "$work/cache$i" --quiet 2>"$work/worker$i.log" &
    running+=($!)
done

lightmill() { # COMMAND JOB [OPTION...]
    "$build/lightmill" "$@" "${address[@]}"
}
state() { # JOB
    lightmill status "$1" --json | sed -n 's/.*"state": "\([a-z]*\)".*/\1/p'
}
wait_for() { # JOB STATE
    until [ "$(state "$1")" = "$2" ]; do
        [ $SECONDS -lt $limit ] || { echo "job $1 is not $2 after $limit s"; exit 1; }
        sleep 0.2
    done
}

scenes=(cornell caustic textures lights-env materials)
for ((i = 1; i <= jobs; i++)); do
    options=(--resolution 24x20 --spp 4 --seed "$i" --name "job $i" --quiet)
    [ $((i % 3)) != 0 ] || options+=(--no-layers)
    [ $((i % 7)) != 0 ] || options+=(--priority 2)
    [ $((i % 10)) != 5 ] || options+=(--spp 100000)
    job=$(lightmill submit "scenes/${scenes[i % 5]}" "${options[@]}")
    case $((i % 10)) in
    2) wait_for "$job" "done" && lightmill fetch "$job" -o "$work/image.exr" >/dev/null ;;
    4) wait_for "$job" "done" && lightmill extend "$job" --spp 8 --quiet >/dev/null ;;
    5) wait_for "$job" running && lightmill pause "$job" && lightmill resume "$job" && lightmill cancel "$job" ;;
    8) wait_for "$job" "done" && lightmill delete "$job" ;;
    esac
done
until ! lightmill status --json | grep -q '"state": "\(queued\|running\|finishing\)"'; do
    [ $SECONDS -lt $limit ] || { echo "jobs are not over after $limit s"; exit 1; }
    sleep 0.2
done
echo bad | timeout 5 bash -c "cat >/dev/tcp/127.0.0.1/$port" || true
lightmill status | sed -n 1p
kill -TERM "$master"
code=0
wait "$master" || code=$?
running=("${running[@]:1}")
kill "${running[@]}"
wait "${running[@]}" || true
running=()
cat "$work/valgrind.log"
[ "$code" = 0 ] || { echo "the master ended with exit code $code"; exit 1; }
echo "$jobs jobs, no leak"
