#!/bin/sh
# Installs what drives the page in a browser: Debian's browser, and two packages of npm into a folder. Does nothing, and
# needs no network, when all is there. The versions are fixed, so that a test does not change by itself.
#
# usage: tests/page/install.sh FOLDER      from the top of the tree
set -eu
folder=$1
docker/install-packages.sh page
packages="playwright-core@1.58.0 axe-core@4.14.1"
there() {
    for package in $packages; do
        grep -qs "^ *\"version\": \"${package#*@}\"" "$folder/node_modules/${package%@*}/package.json" || return 1
    done
}
there && exit 0
mkdir -p "$folder"
# All at once: npm takes out what it is not told of.
# shellcheck disable=SC2086  # a list of words
timeout 300 npm install --prefix "$folder" --no-save --no-audit --no-fund --ignore-scripts --loglevel error $packages
