#!/bin/bash
# Runs test programs one by one, each with a time-out, and sums up: the last line is "N passed, N failed", counting
# single cmocka tests. A program that ends without its own summary (a crash, the time-out) counts as one failure.
#
# usage: tests/run.sh PROGRAM...      TEST_TIMEOUT=SECONDS for one program (default 900)
set -u
limit=${TEST_TIMEOUT:-900}
here=$(cd "$(dirname "$0")" && pwd)
export LSAN_OPTIONS="suppressions=$here/lsan.supp:print_suppressions=0${LSAN_OPTIONS:+:$LSAN_OPTIONS}"
export TSAN_OPTIONS="suppressions=$here/tsan.supp${TSAN_OPTIONS:+:$TSAN_OPTIONS}"
export UBSAN_OPTIONS="print_stacktrace=1${UBSAN_OPTIONS:+:$UBSAN_OPTIONS}"
passed=0
failed=0

# count LOG PATTERN: sums the numbers that follow the pattern.
count() {
    grep -E -o "$2 [0-9]+ test" "$1" | grep -E -o '[0-9]+' | awk '{ sum += $1 } END { print sum + 0 }'
}

for program in "$@"; do
    log=$program.log
    start=$SECONDS
    timeout --kill-after=10 "$limit" "$program" >"$log" 2>&1 </dev/null
    code=$?
    ok=$(count "$log" '\[  PASSED  \]')
    bad=$(count "$log" '^\[  FAILED  \]')
    why=
    if [ "$code" != 0 ] && [ "$bad" = 0 ]; then
        bad=1
        why=" (exit code $code)"
        [ "$code" != 124 ] || why=" (no end within $limit s)"
    fi
    printf '%-40s %4d passed, %d failed%s  %d s\n' "${program#*/tests/}" "$ok" "$bad" "$why" $((SECONDS - start))
    [ "$bad" = 0 ] || grep -E -v '^\[ +(RUN|OK) +\]' "$log" | tail -n 60
    passed=$((passed + ok))
    failed=$((failed + bad))
done
echo "$passed passed, $failed failed"
[ "$failed" = 0 ]
