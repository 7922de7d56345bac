#!/bin/bash
# Prints a hash of the pixels of every scene in scenes/ at a few settings: what must not change when code is only moved.
#
# usage: tests/pixels.sh [BUILD]       e.g. before: tests/pixels.sh >/tmp/before; after: tests/pixels.sh | diff /tmp/before -
set -eu
build=${1:-build}
out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT

# shot SCENE OPTION...: renders it small, and prints the hash of the pixels with what was asked for.
shot() {
    "$build/lightmill" render "$@" --quiet -o "$out/image.exr"
    printf '%s  %s\n' "$("$build/lightmill" info --hash "$out/image.exr")" "$*"
}

for scene in scenes/*/scene.pbrt scenes/*/scene-v4.pbrt scenes/*/*.glb; do
    shot "$scene" --spp 4
    shot "$scene" --spp 4 --resolution 61x47 --seed 7 --sampler independent --tile-size 16
    shot "$scene" --spp 4 --integrator path
    shot "$scene" --spp 4 --integrator light
    shot "$scene" --spp 4 --resolution 64x64 --max-depth 3 --strategies
    shot "$scene" --spp 16 --resolution 64x64 --adaptive
done
