#!/bin/sh
# Installs the Debian packages of the given stages (build, run, test, dev...) that are missing: docker/packages.txt is
# the list. Does nothing, and needs neither network nor root, when all are there.
set -eu
list=$(dirname "$0")/packages.txt
missing=
for stage in "$@"; do
    for package in $(sed -n "s/^$stage  *//p" "$list"); do
        status=$(dpkg-query -W -f='${db:Status-Status}' "$package" 2>/dev/null || true)
        # Builds of Node beside Debian's bring npm along, and conflict with its package.
        [ "$package" != npm ] || ! command -v npm >/dev/null || status=installed
        [ "$status" = installed ] || missing="$missing $package"
    done
done
[ -n "$missing" ] || exit 0
echo "installing:$missing"
root=
if [ "$(id -u)" != 0 ]; then
    command -v sudo >/dev/null || { echo "become root, or install these packages by hand:$missing" >&2; exit 1; }
    root=sudo
fi
$root apt-get update -q
# shellcheck disable=SC2086  # a list of words
$root env DEBIAN_FRONTEND=noninteractive apt-get install -q -y --no-install-recommends $missing
