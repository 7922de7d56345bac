#!/bin/bash
# Builds the images for real and renders a small job through their processes: `make container-check`.
#
# Needs no container engine and no registry: buildah builds in a chroot, on a base image that debootstrap makes when
# $LIGHTMILL_BASE names none; its containers share the machine's network, so the farm runs on loopback. As root.
#
# usage: docker/check.sh BUILD_DIR    (which has the natively built lightmill, to compare with)
set -euo pipefail
build=$(realpath "$1")
top=$(realpath "$(dirname "$0")/..")
[ "$(id -u)" = 0 ] || { echo "container-check: needs root, to make a file system for the images"; exit 1; }
work=$(mktemp -d)
export STORAGE_DRIVER=vfs BUILDAH_ISOLATION=chroot
tool() { buildah --root "$work/store" --runroot "$work/run" "$@"; }
port=$((20000 + RANDOM % 20000))
# Tells the programs in containers to end, and not buildah, which would kill them. The port tells ours from others.
end() { pkill -TERM -f "^(/usr/bin/)?lightmill-$1 .*:$port" || true; }
finish() {
    for _ in 1 2; do # told twice they leave at once
        end worker
        end master
        sleep 0.5
    done
    wait
    tool rm --all >/dev/null 2>&1 || true
    rm -rf "$work"
}
trap finish EXIT
fail() { echo "container-check: $*"; tail -n 20 "$work"/*.log; exit 1; }

# ---- images ------------------------------------------------------------------------------------------------

if [ -z "${LIGHTMILL_BASE:-}" ]; then
    echo "a base image by debootstrap"
    debootstrap --variant=minbase bookworm "$work/base" "${DEBIAN_MIRROR:-http://deb.debian.org/debian}" \
        >"$work/debootstrap.log" || fail "debootstrap failed"
    container=$(tool from scratch)
    tool copy -q "$container" "$work/base" / >/dev/null
    LIGHTMILL_BASE=localhost/debian:12-slim
    tool commit -q "$container" "$LIGHTMILL_BASE" >/dev/null
    tool rm "$container" >/dev/null
    rm -rf "$work/base"
fi
for target in master worker relay client; do
    echo "image lightmill-$target"
    tool bud -q --layers --format docker --pull-never --build-arg BASE="$LIGHTMILL_BASE" --target "$target" \
        -f "$top/docker/Dockerfile" -t "lightmill-$target" "$top" >"$work/build-$target.log" 2>&1 ||
        fail "the image of $target does not build"
done
tool images --format '{{.Name}}: {{.Size}}' | grep lightmill

# ---- containers --------------------------------------------------------------------------------------------

# container NAME IMAGE: makes a container of that image if there is none of this name.
declare -A containers
container() {
    [ -n "${containers[$1]:-}" ] || containers[$1]=$(tool from --pull-never "localhost/lightmill-$2")
}
# run NAME IMAGE [VOLUME...] -- COMMAND...: in a container of that image, as its user.
run() {
    local name=$1 image=$2 volumes=()
    shift 2
    while [ "$1" != -- ]; do volumes+=(-v "$1"); shift; done
    shift
    container "$name" "$image"
    tool run --user 10001:10001 "${volumes[@]}" "${containers[$name]}" "$@"
}
for image in master worker relay client; do
    run "probe-$image" "$image" -- sh -c 'test "$(id -u)" = 10001' || fail "$image runs as root"
    run "probe-$image" "$image" -- sh -c '! command -v gcc cc c++ make ld >/dev/null' || fail "$image has a compiler"
done

# Health sockets lie in /health here: where an image declares a volume, as in /run/lightmill, buildah may put one of its
# own in the place of ours.
mkdir -p "$work"/{keys,data,cache,out,health}
chown -R 10001:10001 "$work"/{keys,data,cache,out,health}
LIGHTMILL="$build/lightmill" "$top/docker/make-keys.sh" "$work/keys" >/dev/null
chown -R 10001:10001 "$work/keys"
# Here, since what a background process puts into `containers` is lost.
container master master
container worker-1 worker
container worker-2 worker
touch "$work/stamp"
run master master "$work/data:/data" "$work/keys:/run/secrets" "$work/health:/health" -- \
    env LIGHTMILL_HEALTH=/health/master lightmill-master --listen "0.0.0.0:$port" --data /data --key /run/secrets/master.secret \
    --allow /run/secrets/allow 2>"$work/master.log" &
started+=($!)
for i in 1 2; do
    run "worker-$i" worker "$work/cache:/cache" "$work/keys:/run/secrets" "$work/health:/health" -- \
        env LIGHTMILL_HEALTH="/health/$i" lightmill-worker --cache /cache "127.0.0.1:$port" --threads 1 \
        --name "$i" --key /run/secrets/worker.secret --master-key /run/secrets/master.key 2>"$work/worker-$i.log" &
    started+=($!)
done
client() {
    run client client "$top/scenes:/scenes:ro" "$work/keys:/run/secrets" "$work/out:/work" -- env \
        LIGHTMILL_MASTER="127.0.0.1:$port" LIGHTMILL_KEY_FILE=/run/secrets/client.secret \
        LIGHTMILL_MASTER_KEY_FILE=/run/secrets/master.key lightmill "$@"
}
settings=(--resolution 96x96 --spp 16)
client submit /scenes/seed-hidden "${settings[@]}" --wait -o /work/farm.exr >"$work/client.log" 2>&1 ||
    fail "the job was not rendered"
run ask-master master "$work/health:/health" -- \
    env LIGHTMILL_HEALTH=/health/master lightmill-master --ask-health || fail "the master does not say that it is well"
run ask-worker worker "$work/health:/health" -- \
    env LIGHTMILL_HEALTH=/health/1 lightmill-worker --ask-health || fail "a worker does not say that it is well"

# ---- what must be true -------------------------------------------------------------------------------------

"$build/lightmill" render "$top/scenes/seed-hidden" "${settings[@]}" --quiet -o "$work/native.exr"
hash_of() { "$build/lightmill" info --hash "$1"; }
[ -n "$(hash_of "$work/native.exr")" ] || fail "no pixel hash to compare"
[ "$(hash_of "$work/out/farm.exr")" = "$(hash_of "$work/native.exr")" ] || fail "the images differ"
echo "the image made in containers has the bits of the one made without: $(hash_of "$work/native.exr")"

for name in master worker-1 worker-2; do
    root=$(tool mount "${containers[$name]}")
    written=$(find "$root" -xdev -newer "$work/stamp" -type f ! -path "$root/proc/*" ! -path "$root/sys/*" \
        ! -path "$root/dev/*" ! -path "$root/run/.containerenv" ! -path "$root/etc/*" | head)
    [ -z "$written" ] || fail "$name writes to its root file system: $written"
done
echo "nothing was written outside the volumes"

end worker
for i in 1 2; do
    wait "${started[$i]}" || fail "worker $i did not leave as it should"
done
end master
wait "${started[0]}" || fail "the master did not leave as it should"
echo "SIGTERM: all left with exit code 0"
echo "container-check passed"
