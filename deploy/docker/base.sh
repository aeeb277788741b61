#!/usr/bin/env bash
# Makes a base image from Debian's packages, for machines that reach no container registry: deploy/docker/base.sh IMAGE
# Needs root, debootstrap and docker. DEBIAN_MIRROR names a mirror other than debootstrap's own.
set -euo pipefail
if [ $# -ne 1 ]; then
    echo "usage: deploy/docker/base.sh IMAGE" >&2
    exit 2
fi
folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
debootstrap --variant=minbase bookworm "$folder/root" ${DEBIAN_MIRROR:+"$DEBIAN_MIRROR"} >"$folder/log" 2>&1 || {
    echo "error: debootstrap failed; the end of its log:" >&2
    tail -n 5 "$folder/log" >&2
    exit 1
}
rm -rf "$folder"/root/var/cache/apt/archives/*.deb "$folder"/root/var/lib/apt/lists/* "$folder"/root/usr/share/{doc,man,locale}
tar --create --directory "$folder/root" . | docker import - "$1"
