#!/bin/bash
# Runs fuzz targets one by one, each for so many seconds, and prints a line for each. New inputs that reach new code are
# kept in DIR/corpus/TARGET from run to run. Seeds are only read: those with a name are files, tests/fuzz/seeds/TARGET/NAME;
# those whose names are hashes are in tests/fuzz/seeds/TARGET.tar. An input that shows a finding is kept in DIR/findings.
# Ends with 1 when there was a finding.
#
# usage: tests/fuzz/run.sh DIR SECONDS TARGET...      from the repository's root; DIR has the programs fuzz_TARGET
#        FUZZ_MERGE=150 tests/fuzz/run.sh DIR 0 TARGET...   instead chooses that many of the corpus as seeds
set -u
dir=$1
seconds=$2
shift 2
shelf=tests/fuzz/seeds
scratch=$(mktemp -d "$([ -w /dev/shm ] && echo /dev/shm || echo /tmp)/lightmill-fuzz-run-XXXXXX") || exit 1
trap 'rm -rf "$scratch"' EXIT
trap 'exit 130' INT TERM
export TMPDIR=$scratch
seeds=$scratch/seeds # all of a target in one folder
export UBSAN_OPTIONS=print_stacktrace=1
export LSAN_OPTIONS=suppressions=$PWD/tests/lsan.supp:print_suppressions=0

# The largest input of a target, in bytes.
limit() {
    case $1 in
    blob | render) echo 32768 ;;
    gltf) echo 16384 ;;
    texture_image | checkpoint) echo 16384 ;;
    *) echo 8192 ;;
    esac
}

# unpack TARGET: its seeds, from the shelf.
unpack() {
    mkdir -p "$seeds/$1"
    find "$shelf/$1" -type f -exec cp -t "$seeds/$1" {} + 2>/dev/null
    [ ! -f "$shelf/$1.tar" ] || tar --extract --file "$shelf/$1.tar" --directory "$seeds/$1"
}

# merge TARGET CORPUS LOG: the archive becomes the smallest FUZZ_MERGE inputs of a set of seeds and corpus that covers all
# that these do. Seeds with a name stay.
merge() {
    local chosen=$scratch/chosen file
    mkdir -p "$chosen" "$chosen.least"
    "$dir/fuzz_$1" "${options[@]}" -set_cover_merge=1 "$chosen" "$seeds/$1" "$2" >"$3" 2>&1 || return 1
    for file in "$shelf/$1"/*; do
        rm -f "$chosen/$(sha1sum <"$file" | cut -c1-40)"
    done
    find "$chosen" -type f -printf '%s %p\n' | sort -n | head -n "$FUZZ_MERGE" | while read -r _ file; do
        cp "$file" "$chosen.least/"
    done
    (cd "$chosen.least" && tar --create --format=ustar --mtime=@0 --owner=0 --group=0 --numeric-owner --mode=0644 -- *) \
        >"$shelf/$1.tar"
    printf '%-16s %d seeds, %s\n' "$1" "$(find "$chosen.least" -type f | wc -l)" "$(du -h "$shelf/$1.tar" | cut -f1)"
    rm -r "$chosen" "$chosen.least"
}

failed=0
for target in "$@"; do
    corpus=$dir/corpus/$target
    log=$dir/fuzz_$target.log
    more=()
    mkdir -p "$corpus" "$dir/findings"
    unpack "$target"
    [ "$target" != render ] || { unpack blob && more=("$seeds/blob"); } # renders what the other only opens
    options=(-rss_limit_mb=2048 -malloc_limit_mb=1024 -timeout=60 -max_len="$(limit "$target")"
        -print_final_stats=1 -artifact_prefix="$dir/findings/$target-" -verbosity=1)
    for name in "$target" "${target%%_*}"; do
        [ ! -f "tests/fuzz/$name.dict" ] || { options+=(-dict="tests/fuzz/$name.dict") && break; }
    done
    if [ -n "${FUZZ_MERGE:-}" ]; then
        merge "$target" "$corpus" "$log" || failed=1
        continue
    fi
    "$dir/fuzz_$target" "${options[@]}" -max_total_time="$seconds" "$corpus" "$seeds/$target" \
        ${more[@]+"${more[@]}"} >"$log" 2>&1 </dev/null
    code=$?
    runs=$(sed -n 's/^stat::number_of_executed_units: *//p' "$log")
    coverage=$(grep -o 'cov: [0-9]*' "$log" | tail -n 1)
    found="no finding"
    [ "$code" = 0 ] || {
        failed=1
        found="a FINDING: $(sed -n 's/.*Test unit written to //p' "$log" | tail -n 1) ($log)"
    }
    printf '%-16s %9s executions, %6s edges, %s\n' "$target" "${runs:-0}" "${coverage#cov: }" "$found"
    [ "$code" = 0 ] || grep -E -A 12 'runtime error|ERROR: |^finding:|out of memory' "$log" | head -n 30
done
exit $failed
