#!/usr/bin/env bash
# The build stage of deploy/docker/Dockerfile: fills DESTINATION with what the images hold.
#
# What `deploy/docker/collect.sh target/image` collected before is used as it is: on a machine that has just built the
# checkout, compiling it again inside a container would give the same programs some minutes later.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."
destination="$1"

if [ -d target/image/learner ] && [ -d target/image/actor ]; then
    echo "using the programs in target/image"
    mv target/image "$destination"
    exit 0
fi
# pip for SUMO and libtorch; X11 and GL, because SUMO's programs link them.
apt-get update -q
apt-get install -q -y --no-install-recommends python3-pip python3-venv binutils libx11-6 libxext6 libxrender1 libgl1 libatomic1 libexpat1
make build
deploy/docker/collect.sh "$destination"
