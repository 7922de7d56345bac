#!/bin/bash
# A scene of many large images is imported and rendered by processes that may use LIMIT MiB of memory, far less than the
# images take; and rendered again without a limit. Says how long that took, and ends with 1 when the pictures differ, or
# when a limited process did not live. The limit is a control group's, which counts what the kernel keeps of files, too.
#
# usage: tests/bench/textures.sh [BUILD]
#   IMAGES=16    SIDE=8192 (pixels; an image takes 4 bytes a pixel)    LIMIT=1024 (MiB)    SPP=4    SIZE=640x640
#   DISK=/var/tmp (has room for three times the images)
set -eu
build=$(realpath "${1:-build}")
images=${IMAGES:-16} side=${SIDE:-8192} limit=${LIMIT:-1024} spp=${SPP:-4} size=${SIZE:-640x640}
folder=$(mktemp -d -p "${DISK:-/var/tmp}")
export TMPDIR=$folder
group=''

finish() {
    [ -z "$group" ] || rmdir "$group" 2>/dev/null || true
    rm -rf "$folder"
}
trap finish EXIT

# A control group of that limit, of version 2 or 1: its folder.
make_group() {
    local name=lightmill-textures.$$
    if [ -e /sys/fs/cgroup/cgroup.controllers ]; then
        group=/sys/fs/cgroup/$name
        mkdir "$group" 2>/dev/null && echo $((limit << 20)) >"$group/memory.max" && echo 0 >"$group/memory.swap.max"
    else
        group=/sys/fs/cgroup/memory/$name
        mkdir "$group" 2>/dev/null && echo $((limit << 20)) >"$group/memory.limit_in_bytes"
    fi
}

# limited COMMAND...: runs it in the group.
limited() {
    (
        echo "$BASHPID" >"$group/cgroup.procs"
        exec "$@"
    )
}

seconds() {
    awk -v a="$1" -v b="$(date +%s.%N)" 'BEGIN { printf "%.1f s", b - a }'
}

make_group || { group=''; echo "textures: skipped: no control group can be made here (that takes root)"; exit 0; }

python3 - "$folder" "$images" "$side" <<'PYTHON'
"""Images of stripes, each another, and a wall of all of them."""
import os
import struct
import sys
import zlib

folder, images, side = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def write_png(path, seed):
    cycle = bytes((i * (2 * seed + 3) >> 2) & 255 for i in range(1024))
    line = cycle * (side * 3 // 1024 + 2)
    packer = zlib.compressobj(1)
    with open(path, "wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0)))
        for y in range(side):
            start = (y * (seed + 5) >> 3) % 1024
            packed = packer.compress(b"\0" + line[start : start + 3 * side])
            if packed:
                file.write(chunk(b"IDAT", packed))
        file.write(chunk(b"IDAT", packer.flush()) + chunk(b"IEND", b""))


across = 1
while across * across < images:
    across += 1
with open(os.path.join(folder, "scene.pbrt"), "w") as scene:
    scene.write('LookAt 0 0 -1.9  0 0 0  0 1 0\nCamera "perspective" "float fov" [60]\nFilm "rgb"\n'
                'Integrator "path" "integer maxdepth" [4]\nWorldBegin\nLightSource "infinite"\n')
    for i in range(images):
        write_png(os.path.join(folder, f"{i}.png"), i)
        x, y, w = -1 + 2 * (i % across) / across, -1 + 2 * (i // across) / across, 2 / across
        scene.write(f'Texture "{i}" "spectrum" "imagemap" "string filename" "{i}.png"\n'
                    f'Material "diffuse" "texture reflectance" "{i}"\n'
                    'Shape "trianglemesh" "integer indices" [0 1 2 0 2 3] "point2 uv" [0 0 1 0 1 1 0 1] '
                    f'"point3 P" [{x} {y} 0  {x + w} {y} 0  {x + w} {y + w} 0.3  {x} {y + w} 0.3]\n')
PYTHON
echo "$images images of $side x $side: $((images * side * side * 4 >> 20)) MiB in memory, of which there are $limit MiB"

start=$(date +%s.%N)
limited "$build/lightmill" import "$folder/scene.pbrt" --quiet -o "$folder/scene.blob"
echo "imported in $limit MiB: $(seconds "$start"), a blob of $(stat -c %s "$folder/scene.blob") bytes"
start=$(date +%s.%N)
limited "$build/lightmill" render "$folder/scene.blob" --resolution "$size" --spp "$spp" --quiet -o "$folder/limited.exr"
echo "rendered in $limit MiB: $(seconds "$start")"
start=$(date +%s.%N)
"$build/lightmill" render "$folder/scene.blob" --resolution "$size" --spp "$spp" --quiet -o "$folder/free.exr"
echo "rendered without a limit: $(seconds "$start")"
limited_hash=$("$build/lightmill" info --hash "$folder/limited.exr") free_hash=$("$build/lightmill" info --hash "$folder/free.exr")
[ "$limited_hash" = "$free_hash" ] || { echo "textures: the pictures differ: $limited_hash, $free_hash"; exit 1; }
echo "the same pixels: $free_hash"
