#!/bin/sh
# Makes the keys of a farm in containers, once: docker/keys with those of the master, of its workers and of a client, and
# the list of whom the master admits. `lightmill` is the program, or a container of the client image.
#
# usage: docker/make-keys.sh [DIRECTORY]
set -eu
here=$(dirname "$0")
keys=${1:-$here/keys}
lightmill=${LIGHTMILL:-$here/../build/lightmill}
[ ! -e "$keys/allow" ] || { echo "$keys has keys already" >&2; exit 1; }
mkdir -p "$keys"
chmod 700 "$keys"
$lightmill keygen master --out "$keys" >/dev/null
{
    echo "# who may use this farm: RIGHT KEY NAME"
    $lightmill keygen worker --out "$keys"
    $lightmill keygen client --out "$keys"
} >"$keys/allow.new"
mv "$keys/allow.new" "$keys/allow"
# The containers' user reads the secrets; the directory keeps them from other users of this machine.
if [ "$(id -u)" = 0 ]; then chown 10001:10001 "$keys"/*.secret; else chmod 644 "$keys"/*.secret; fi
