#!/bin/bash
# Holds the rule of the layers: which folder may use which, how large a folder may grow, and that neither includes nor
# calls go round in circles. Says file, line and rule of what breaks it, and ends with 1.
#
# usage: tests/layers.sh [BUILD]      from anywhere; BUILD (build) has the objects, whose symbols tell who calls whom
set -euo pipefail
cd "$(dirname "$0")/.."
build=${1:-build}

# A row: a folder, and the folders that it may use, with all that those may use. A row names only rows above it, so
# that arrows run one way. A folder that has no row breaks the rule.
rules() {
    cat <<'END'
common
common/image                : common
common/options              : common
common/colour               : common
common/notify               : common/options
common/text                 : common
common/scene                : common/text
common/film                 : common/image common/scene
proto/wire                  : common/film common/scene common/options common/text
proto/uplink                : proto/wire
proto/serve                 : proto/wire
worker/render/sampling      : common
worker/render/spectral      : common/scene common/colour
worker/render/texture       : worker/render/sampling common/scene
worker/render/scene         : worker/render/texture
worker/render/bsdf          : worker/render/sampling worker/render/spectral
worker/render/tabulated     : worker/render/bsdf
worker/render/medium        : worker/render/bsdf worker/render/texture
worker/render/material      : worker/render/tabulated worker/render/scene
worker/render/camera        : worker/render/scene
worker/render/light         : worker/render/scene
worker/render/integrator    : worker/render/material worker/render/medium worker/render/camera worker/render/light common/film
worker/render/plan          : worker/render/integrator
worker/render               : worker/render/plan
worker                      : worker/render proto/uplink
master/schedule             : common/film
master/film                 : proto/wire
master/store                : master/schedule master/film
master/state                : master/store proto/serve
master/trust                : master/state
master/farm                 : master/trust
master/http/access          : proto/wire
master/http/parse           : proto/wire
master/http/watch           : master/farm
master/http                 : master/farm master/http/access master/http/parse master/http/watch
master/threads              : master/http common/notify
master                      : master/threads
relay                       : proto/uplink proto/serve
client/import/scene         : common/scene common/image common/options
client/import/files         : client/import/scene common/colour
client/import/environment   : client/import/files
client/import/tessellate    : client/import/scene
client/import/obj           : client/import/files
client/import/mitsuba       : client/import/environment client/import/obj
client/import/packed        : common
client/import/volume        : client/import/scene client/import/packed
client/import/gltf          : client/import/environment client/import/packed
client/import/pbrt/syntax    : client/import/files
client/import/pbrt/state     : client/import/pbrt/syntax
client/import/pbrt/materials : client/import/pbrt/state client/import/volume
client/import/pbrt/shapes    : client/import/pbrt/materials client/import/tessellate
client/import/pbrt           : client/import/pbrt/shapes
client/import               : client/import/pbrt client/import/gltf client/import/obj client/import/mitsuba client/import/environment
client/text                 : proto/wire
client/scene                : client/import client/text
client/image                : common/options common/film
client/farm                 : client/scene client/image common/notify proto/uplink master worker
client/commands             : client/farm
client                      : client/commands
END
}

max_pairs=16 # of a .c and its .h in a folder, headers alone counted too
max_circle=4 # files that call one another in a circle, within a folder

mapfile -t sources < <(find client common master proto relay worker -name '*.[ch]' -o -name '*.cc' | sort)
objects=()
for source in "${sources[@]}"; do
    case $source in *.c | *.cc) objects+=("$build/${source%.*}.o") ;; esac
done
ls "${objects[@]}" >/dev/null || { echo "layers: objects are missing: make all tests" >&2; exit 1; }

{
    rules | sed 's/^/rule /'
    printf 'file %s\n' "${sources[@]}"
    grep -Hn '^ *# *include "' "${sources[@]}" | sed -E 's/^([^:]*):([0-9]+):[^"]*"([^"]*)".*/include \1 \2 \3/'
    nm -A -g --no-sort "${objects[@]}" | sed -E "s,^$build/([^:]*)\.o:.* ([A-Za-z]) ([^ ]*)$,symbol \1.c \2 \3,"
} | awk -v max_pairs="$max_pairs" -v max_circle="$max_circle" '
function folder(file) { sub(/\/[^\/]*$/, "", file); return file }
function complain(text) { print "layers: " text; ++complaints }
function list_of(from,   text, i) {
    for (i = 1; i <= row_count; ++i) if ((from, row[i]) in may) text = text " " row[i]
    return text ? "only" text : "nothing"
}

$1 == "rule" {
    row[++row_count] = $2
    known[$2] = row_count
    for (i = 4; i <= NF; ++i) {
        if (!($i in known)) complain("the rule of " $2 " names " $i ", which has no row above it")
        may[$2, $i] = 1
        for (k = 1; k <= row_count; ++k) if (($i, row[k]) in may) may[$2, row[k]] = 1
    }
}
$1 == "file" {
    file[++file_count] = $2
    is_file[$2] = 1
    stem = $2
    sub(/\.(c|h|cc)$/, "", stem)
    if (!(stem in stems)) ++pairs[folder($2)]
    if ($2 !~ /h$/) stems[stem] = $2 # the file that its object is made of
    else stems[stem]
}
$1 == "include" {
    from = folder($2); to = folder($4)
    if (!(from in known) && !(from in unknown)) { unknown[from] = 1; complain($2 ": the folder " from " has no rule: give it a row in tests/layers.sh") }
    if (from != to && !((from, to) in may))
    {
        complain($2 ":" $3 ": " from " may use " list_of(from) ", not " $4)
        told[$2, to] = 1
    }
    if ($4 in is_file) { includes[$2] = includes[$2] " " $4; why["include", $2, $4] = "line " $3 }
}
$1 == "symbol" { sub(/\.c$/, "", $2); $2 = stems[$2] }
$1 == "symbol" && $3 == "U" { wanted[++wanted_count] = $2 " " $4 }
$1 == "symbol" && $3 ~ /[A-TVX-Z]/ && $4 != "main" { home[$4] = $2 }

# Tarjan (1972), "Depth-First Search and Linear Graph Algorithms": the strongly connected components of `next_of`.
function visit(node,   count, other, i) {
    number[node] = low[node] = ++numbers
    stack[++depth] = node
    on_stack[node] = 1
    count = split(next_of[node], others_of_node, " ")
    for (i = 1; i <= count; ++i) {
        split(next_of[node], others_of_node, " ")
        other = others_of_node[i]
        if (!(other in number)) { visit(other); if (low[other] < low[node]) low[node] = low[other] }
        else if (on_stack[other] && number[other] < low[node]) low[node] = number[other]
    }
    if (low[node] == number[node]) component(node)
}
# Takes the component of `node` from the stack, and judges it when it is a circle.
function component(node,   members, count, folders, seen, f, i, j, list) {
    do { members[++count] = stack[depth]; on_stack[stack[depth]] = 0 } while (stack[depth--] != node)
    if (count == 1) return
    for (i = 1; i <= count; ++i) if (!(folder(members[i]) in seen)) { seen[folder(members[i])] = 1; ++folders }
    if (kind == "call" && folders == 1 && count <= max_circle) return
    for (i = 1; i <= row_count; ++i) if (row[i] in seen) list = list " " row[i]
    complain(count " files " kind " one another in a circle, in" list ":")
    for (i = 1; i <= count; ++i) for (j = 1; j <= count; ++j)
        if ((kind, members[i], members[j]) in why) print "    " members[i] " -> " members[j] ", " why[kind, members[i], members[j]]
}
function circles(of,   i) {
    kind = of
    split("", number)
    for (i = 1; i <= file_count; ++i) if (!(file[i] in number)) visit(file[i])
}

END {
    for (name in pairs) if (pairs[name] > max_pairs)
        complain(name " has " pairs[name] " source pairs; at most " max_pairs " fit into a folder")
    for (i = 1; i <= file_count; ++i) next_of[file[i]] = includes[file[i]]
    circles("include")
    split("", next_of)
    for (i = 1; i <= wanted_count; ++i) {
        split(wanted[i], edge, " ")
        from = edge[1]; to = home[edge[2]]
        if (to == "" || to == from) continue
        if (!(("call", from, to) in why)) next_of[from] = next_of[from] " " to
        why["call", from, to] = edge[2] "()"
        a = folder(from); b = folder(to)
        if (a != b && !((a, b) in may) && !told[from, b]++)
            complain(from ": " a " may use " list_of(a) ", not " edge[2] "() of " to)
    }
    circles("call")
    exit complaints > 0
}'
