#!/bin/bash
# Runs test programs, each with a time-out, and sums up: the last line is "N passed, N failed", counting single cmocka
# tests. A program that ends without its own summary (a crash, the time-out) counts as one failure.
#
# Programs run side by side: as many as keep JOBS cores busy, by what tests/costs.txt says of them, the longest first. Most
# of them wait for something, so more than JOBS run. Statistics compute for minutes and wait for nothing: they get, at
# the lowest priority, what the others leave, and where there are any a quarter of the cores is left to them. Each
# program has TCP ports of its own, in TEST_PORTS. Those that start no other processes (unit, statistics) have their
# files in memory. All of a run share the folder LIGHTMILL_REFERENCES: tests/rig.c renders an image that several of them
# compare with only once.
#
# --apart, for programs that a sanitizer makes slow: those that start processes have the machine to themselves.
#
# usage: tests/run.sh [-j JOBS] [--apart] PROGRAM...      TEST_TIMEOUT=SECONDS for one program (default 900)
set -u
limit=${TEST_TIMEOUT:-900}
jobs=1
apart=
if [ "${1:-}" = -j ]; then
    jobs=$2
    shift 2
fi
if [ "${1:-}" = --apart ]; then
    apart=yes
    shift
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
mkdir "$scratch/references" || exit 1
export LIGHTMILL_REFERENCES=$scratch/references

# count LOG PATTERN: sums the numbers that follow the pattern.
count() {
    grep -E -o "$2 [0-9]+ test" "$1" | grep -E -o '[0-9]+' | awk '{ sum += $1 } END { print sum + 0 }'
}

# run PROGRAM: one line about it, more when it failed, and its numbers to the counts.
run() {
    local program=$1 log=$1.log start=${EPOCHREALTIME/./} code ok bad why="" seconds cpu TIMEFORMAT='%U %S'
    { time timeout --kill-after=10 "$limit" "$program" >"$log" 2>&1 </dev/null; } 2>"$log.cpu"
    code=$?
    seconds=$(((${EPOCHREALTIME/./} - start) / 100000))
    cpu=$(awk 'END { printf "%.1f", $1 + $2 }' "$log.cpu")
    ok=$(count "$log" '\[  PASSED  \]')
    bad=$(count "$log" '^\[  FAILED  \]')
    if [ "$code" != 0 ] && [ "$bad" = 0 ]; then
        bad=1
        why=" (exit code $code)"
        [ "$code" != 124 ] || why=" (no end within $limit s)"
    fi
    {
        printf '%-44s %4d passed, %d failed%s  %d.%d s, %s s of CPU\n' "${program#*/tests/}" "$ok" "$bad" "$why" \
            $((seconds / 10)) $((seconds % 10)) "$cpu"
        [ "$bad" = 0 ] || grep -E -v '^\[ +(RUN|OK) +\]' "$log" | tail -n 60
    } >"$log.told"
    cat "$log.told" # in one piece
    rm "$log.told" "$log.cpu"
    echo "$ok $bad" >>"$scratch/counts"
}

# ---- what each costs ----

declare -A known_seconds known_cores seconds_of cores_of lane_of
while read -r name seconds cores; do
    known_seconds[$name]=$seconds
    known_cores[$name]=$cores
done < <(grep -v '^#' "$here/costs.txt")

# Hundredths of a core that are free, by lane.
declare -A idle=([front]=$((100 * jobs)) [back]=$((100 * jobs)))
case $apart:$* in :*/tests/statistics/*) idle[front]=$((75 * jobs)) ;; esac

# weigh PROGRAM: its seconds, the hundredths of a core that it keeps busy, and the lane whose cores these are.
weigh() {
    local name=${1#*/tests/} seconds=1 cores=100 lane=front
    case $name in unit/*) ;; *) seconds=30 ;; esac
    seconds=${known_seconds[$name]:-$seconds}
    cores=${known_cores[$name]:-$cores}
    case $apart:$name in
        :statistics/*) lane=back && cores=100 ;; # also what has a process for each core: none is left for the end
        :*) ;;
        yes:unit/* | yes:statistics/*) cores=100 ;;
        *) cores=${idle[front]} ;;
    esac
    [ "$cores" != all ] || { cores=${idle[$lane]} && seconds=$((10000 + seconds)); } # first, before others are in its way
    [ "$cores" -le "${idle[$lane]}" ] || cores=${idle[$lane]}
    seconds_of[$1]=$seconds
    cores_of[$1]=$cores
    lane_of[$1]=$lane
}

# ---- who runs ----

readonly FIRST_PORT=20000 SLOTS=24 SLOT_PORTS=500
declare -A program_of slot_of # by process
declare -a taken              # by slot

# start PROGRAM SLOT
start() {
    local first=$((FIRST_PORT + SLOT_PORTS * $2)) lane=${lane_of[$1]}
    (
        export TEST_PORTS=$first-$((first + SLOT_PORTS - 1))
        case $1 in */tests/unit/* | */tests/statistics/*) export TMPDIR=$scratch ;; esac
        [ "$lane" = front ] || { renice -n 19 "$BASHPID" >/dev/null && limit=$((3 * limit)); }
        run "$1"
    ) &
    program_of[$!]=$1
    slot_of[$!]=$2
    taken[$2]=yes
    idle[$lane]=$((idle[$lane] - cores_of[$1]))
}

# Waits until a program ends, and takes back what it had.
collect() {
    local process="" program lane
    wait -n -p process "${!program_of[@]}"
    program=${program_of[$process]}
    lane=${lane_of[$program]}
    idle[$lane]=$((idle[$lane] + cores_of[$program]))
    taken[${slot_of[$process]}]=
    unset "program_of[$process]" "slot_of[$process]"
}

# Starts what there is room for, and leaves the rest in `queue`.
start_some() {
    local program slot=0 rest=()
    for program in "${queue[@]}"; do
        while [ "$slot" -lt $SLOTS ] && [ -n "${taken[$slot]:-}" ]; do slot=$((slot + 1)); done
        if [ "$slot" -lt $SLOTS ] && [ "${cores_of[$program]}" -le "${idle[${lane_of[$program]}]}" ]; then
            start "$program" "$slot"
        else
            rest+=("$program")
        fi
    done
    queue=("${rest[@]}")
}

for program in "$@"; do weigh "$program"; done
mapfile -t queue < <(for program in "$@"; do echo "${seconds_of[$program]} $program"; done | sort -s -n -r -k 1,1 | cut -d ' ' -f 2-)
while start_some && [ "${#program_of[@]}" -gt 0 ]; do collect; done
missing=$(($# - $(wc -l <"$scratch/counts")))
[ "$missing" = 0 ] || echo "$missing of $# programs did not run to their end"
awk -v failed="$missing" '{ passed += $1; failed += $2 } END { print passed + 0 " passed, " failed + 0 " failed"; exit failed > 0 }' \
    "$scratch/counts"
