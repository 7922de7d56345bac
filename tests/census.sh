#!/bin/bash
# Imports every scene below a folder three times: strictly, with warnings, leniently. Prints how many come in, for each
# folder below it, and why the others do not: what a collection of public scenes costs its users.
#
# usage: tests/census.sh DIR [BUILD]      CENSUS_SECONDS (60) and CENSUS_MEGABYTES (4096, or unlimited) bound each import
#
# A scene is a .pbrt file with a WorldBegin, an .xml file with a <scene, or a .gltf, .glb or .obj file. The report, a line
# a scene, is left in BUILD/census.tsv (CENSUS_REPORT names another file): what came of it (strict, warned, lenient, refused, slow, crash), the file, and why it did not come in
# strictly, or with warnings.
set -euo pipefail

folder=${1:?usage: tests/census.sh DIR [BUILD]}
build=${2:-build}
seconds=${CENSUS_SECONDS:-60}
megabytes=${CENSUS_MEGABYTES:-4096}
report=${CENSUS_REPORT:-$build/census.tsv}
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT

scenes() {
    find -L "$folder" -type f \( -name '*.pbrt' -exec grep -qE '^[[:space:]]*WorldBegin' {} \; -o \
        -name '*.xml' -exec grep -q '<scene' {} \; -o \
        -name '*.gltf' -o -name '*.glb' -o -name '*.obj' \) -print | sort
}

# import SCENE OPTION...: one bounded import; its status, and its error in $scratch/error.
import() {
    local status=0
    (
        [[ $megabytes == unlimited ]] || ulimit -v $((megabytes * 1024))
        exec timeout --kill-after=5 "$seconds" "$build/lightmill" import "$@" --quiet -o "$scratch/scene.blob"
    ) >/dev/null 2>"$scratch/log" || status=$?
    rm -f "$scratch/scene.blob"
    tail -n 1 "$scratch/log" >"$scratch/error"
    return $status
}

# What a status of 0 does not say: 1 to 9 are errors that a program tells, 124 and 137 those of timeout.
name_of_failure() {
    case $1 in [1-9]) echo refused ;; 124 | 137) echo slow ;; *) echo crash ;; esac
}

# What came of the scene; the error of the severest import that failed is in $scratch/first.
judge() {
    local scene=$1 kind options status
    : >"$scratch/first"
    for kind in strict warned lenient; do
        options=()
        [[ $kind == strict ]] && options=(--strict)
        [[ $kind == lenient ]] && options=(--lenient)
        status=0
        import "$scene" "${options[@]}" || status=$?
        ((status == 0)) && { echo "$kind"; return; }
        [[ $kind != lenient ]] && cp "$scratch/error" "$scratch/first"
        [[ $(name_of_failure $status) == refused ]] || break
    done
    name_of_failure $status
}

while IFS= read -r scene; do
    outcome=$(judge "$scene")
    printf '%s\t%s\t%s\n' "$outcome" "${scene#"$folder"/}" "$(tr '\t\n' '  ' <"$scratch/first")"
done < <(scenes) >"$report"

# The table: a row for each folder below DIR, and one for all.
row='%-40.40s %7s %7s %9s %10s %8s %6s %6s\n'
# shellcheck disable=SC2059 # the format is the line above
printf "$row" "" scenes strict warnings --lenient refused slow crash
awk -F '\t' -v row="$row" '
    function count(name) { files[name]++; n[name, $1]++ }
    { folder = $2; if (!sub("/.*", "", folder)) folder = "."; count(folder); count("~ all") }
    END {
        for (name in files) {
            strict = n[name, "strict"] + 0; warned = strict + n[name, "warned"]; lenient = warned + n[name, "lenient"]
            printf row, name, files[name], strict, warned, lenient, n[name, "refused"] + 0, n[name, "slow"] + 0, n[name, "crash"] + 0
        }
    }' "$report" | sort

# What keeps scenes out that do not come in with warnings: messages without places, names and numbers.
echo
awk -F '\t' '$1 != "strict" && $1 != "warned" { print $3 }' "$report" |
    sed -E 's/^[^ ]*: error: //; s/^lightmill: //; s/^([^ :]*\/)?[^ :]*(:[0-9]+)*: //; s/"[^"]*"/"..."/g; s/[0-9][0-9.e+-]*/N/g' |
    sort | uniq -c | sort -rn | head -n 40
