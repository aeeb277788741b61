#!/usr/bin/env bash
# Packs the programs of a built checkout into the images cross-learner and cross-actor, without compiling in a container.
#
#   BASE_IMAGE       what the images stand on (debian:bookworm-slim); deploy/docker/base.sh makes one without a registry
#   LEARNER_IMAGE    names of the results (cross-learner:latest, cross-actor:latest)
#   ACTOR_IMAGE
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."
base="${BASE_IMAGE:-debian:bookworm-slim}"
collected=target/image
trap 'rm -rf "$collected"' EXIT
deploy/docker/collect.sh "$collected"

image() {
    # Nothing is compiled, so the base image serves as the builder too.
    docker build --quiet --file deploy/docker/Dockerfile --target "$1" --tag "$2" \
        --build-arg "BUILDER_IMAGE=$base" --build-arg "BASE_IMAGE=$base" \
        --build-arg "REVISION=$(git rev-parse --short HEAD 2>/dev/null || echo unknown)" .
    docker image ls "$2" --format '{{.Repository}}:{{.Tag}} has {{.Size}}'
}
image learner "${LEARNER_IMAGE:-cross-learner:latest}"
image actor "${ACTOR_IMAGE:-cross-actor:latest}"
docker image prune --force --filter label=cross.stage=build >/dev/null
