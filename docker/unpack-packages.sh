#!/bin/sh
# Unpacks the programs of the Debian packages of the stage "unpack" (docker/packages.txt) into FOLDER/usr/bin: tests use
# them, but if the packages were installed, Debian would start them as services. Does nothing, and needs no network, when all are there,
# unpacked or installed.
#
# usage: docker/unpack-packages.sh FOLDER
set -eu
folder=$1
list=$(dirname "$0")/packages.txt
root=
[ "$(id -u)" = 0 ] || root=sudo

unpack() {
    work=$(mktemp -d "$folder/unpack-XXXXXX")
    # Where the lists of packages were deleted, as in containers, the first try fails.
    (cd "$work" && { apt-get download -q "$1" 2>/dev/null || { $root apt-get update -q && apt-get download -q "$1"; }; }) &&
        dpkg-deb --fsys-tarfile "$work/$1"_*.deb | tar -x -C "$folder" ./usr/bin && touch "$folder/$1.unpacked"
    rm -rf "$work"
}

for package in $(sed -n "s/^unpack  *//p" "$list"); do
    [ "$(dpkg-query -W -f='${db:Status-Status}' "$package" 2>/dev/null || true)" != installed ] || continue
    [ ! -e "$folder/$package.unpacked" ] || continue
    echo "unpacking $package into $folder"
    mkdir -p "$folder"
    unpack "$package"
    [ -e "$folder/$package.unpacked" ] || { echo "cannot unpack $package; or install it by hand" >&2; exit 1; }
done
