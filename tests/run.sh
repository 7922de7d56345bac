#!/bin/bash
# Runs test programs, each with a time-out, and sums up: the last line is "N passed, N failed", counting single cmocka
# tests. A program that ends without its own summary (a crash, the time-out) counts as one failure.
#
# Statistics and unit tests come first, JOBS at a time and with their files in memory: they share nothing. The former
# compute on one thread, and many of the latter wait. All others have the machine, and its disk, to themselves.
#
# usage: tests/run.sh [-j JOBS] PROGRAM...      TEST_TIMEOUT=SECONDS for one program (default 900)
set -u
limit=${TEST_TIMEOUT:-900}
jobs=1
if [ "${1:-}" = -j ]; then
    jobs=$2
    shift 2
fi
here=$(cd "$(dirname "$0")" && pwd)
PATH=$PATH:$here/../build/debian/usr/bin # docker/unpack-packages.sh
export LSAN_OPTIONS="suppressions=$here/lsan.supp:print_suppressions=0${LSAN_OPTIONS:+:$LSAN_OPTIONS}"
export TSAN_OPTIONS="suppressions=$here/tsan.supp${TSAN_OPTIONS:+:$TSAN_OPTIONS}"
export UBSAN_OPTIONS="print_stacktrace=1${UBSAN_OPTIONS:+:$UBSAN_OPTIONS}"
memory=${TMPDIR:-/tmp}
[ -w /dev/shm ] && memory=/dev/shm
scratch=$(mktemp -d "$memory/lightmill-run-XXXXXX") || exit 1
trap 'rm -rf "$scratch"' EXIT
trap 'exit 130' INT TERM
: >"$scratch/counts"

# count LOG PATTERN: sums the numbers that follow the pattern.
count() {
    grep -E -o "$2 [0-9]+ test" "$1" | grep -E -o '[0-9]+' | awk '{ sum += $1 } END { print sum + 0 }'
}

# run PROGRAM: one line about it, more when it failed, and its numbers to the counts.
run() {
    local program=$1 log=$1.log start=${EPOCHREALTIME/./} code ok bad why="" seconds
    timeout --kill-after=10 "$limit" "$program" >"$log" 2>&1 </dev/null
    code=$?
    seconds=$(((${EPOCHREALTIME/./} - start) / 100000))
    ok=$(count "$log" '\[  PASSED  \]')
    bad=$(count "$log" '^\[  FAILED  \]')
    if [ "$code" != 0 ] && [ "$bad" = 0 ]; then
        bad=1
        why=" (exit code $code)"
        [ "$code" != 124 ] || why=" (no end within $limit s)"
    fi
    {
        printf '%-44s %4d passed, %d failed%s  %d.%d s\n' "${program#*/tests/}" "$ok" "$bad" "$why" \
            $((seconds / 10)) $((seconds % 10))
        [ "$bad" = 0 ] || grep -E -v '^\[ +(RUN|OK) +\]' "$log" | tail -n 60
    } >"$log.told"
    cat "$log.told" # in one piece
    rm "$log.told"
    echo "$ok $bad" >>"$scratch/counts"
}

together=()
for program in "$@"; do
    case $program in */tests/statistics/*) together+=("$program") ;; esac
done
for program in "$@"; do
    case $program in */tests/unit/*) together+=("$program") ;; esac
done
running=0
for program in "${together[@]}"; do
    [ "$running" -lt "$jobs" ] || wait -n
    [ "$running" -ge "$jobs" ] || running=$((running + 1))
    TMPDIR=$scratch run "$program" &
done
wait
for program in "$@"; do
    case $program in */tests/unit/* | */tests/statistics/*) ;; *) run "$program" ;; esac
done
awk '{ passed += $1; failed += $2 } END { print passed + 0 " passed, " failed + 0 " failed"; exit failed > 0 }' "$scratch/counts"
