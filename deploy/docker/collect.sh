#!/usr/bin/env bash
# Collects from a built checkout what the images hold, and nothing else: deploy/docker/collect.sh DESTINATION
#
#   DESTINATION/learner   programs, libtorch, scenarios with their nets
#   DESTINATION/actor     what an actor needs besides: its program and SUMO with its libraries
#
# The layout is the checkout's, because the programs look for libtorch, SUMO and scenarios relative to themselves.
# Programs are stripped: symbols are nine tenths of them.
set -euo pipefail

if [ $# -ne 1 ]; then
    echo "usage: deploy/docker/collect.sh DESTINATION" >&2
    exit 2
fi
root="$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)"
release="${CARGO_TARGET_DIR:-$root/target}/release"
for needed in "$release/cross" "$release/cross-learner" "$release/cross-actor" "$root/.deps/sumo/sumo/bin/sumo" "$root/.deps/libtorch/torch/lib/libtorch_cpu.so"; do
    if [ ! -e "$needed" ]; then
        echo "error: $needed is missing; run make build first (the images take SUMO and libtorch from .deps/)" >&2
        exit 1
    fi
done
destination="$1"
rm -rf "$destination"
mkdir -p "$destination"
destination="$(cd "$destination" && pwd)"

program() {
    local to="$destination/$1/opt/cross/target/release"
    mkdir -p "$to"
    cp "$release/$2" "$to/$2"
    strip --strip-all "$to/$2"
}

# Paths of the shared libraries that a program loads.
libraries() {
    ldd "$1" | awk '$2 == "=>" && $3 ~ /^\// { print $3 }' | sort -u
}

# Copies a library under the name that the loader asks for, also where that is a link. Programs share some.
take() {
    [ -e "$2/${1##*/}" ] || cp -L "$1" "$2/"
}

# The C and C++ runtime is the base image's.
is_runtime() {
    case "${1##*/}" in
    libc.so* | libm.so* | libdl.so* | librt.so* | libpthread.so* | libutil.so* | libresolv.so* | libstdc++.so* | libgcc_s.so*) return 0 ;;
    *) return 1 ;;
    esac
}

echo "collecting the learner: programs, libtorch, scenarios"
program learner cross
program learner cross-learner
deps="$destination/learner/opt/cross/.deps"
# All that the programs load besides the C and C++ runtime, wherever it was found: libtorch, and the two small CUDA
# libraries that even its CPU form is linked with. One folder; the image tells the loader of it.
mkdir -p "$deps/libtorch/torch/lib"
for library in $(libraries "$release/cross-learner"); do
    is_runtime "$library" || take "$library" "$deps/libtorch/torch/lib"
done
if [ ! -e "$deps/libtorch/torch/lib/libtorch_cpu.so" ]; then
    echo "error: $release/cross-learner does not find libtorch; run make build again" >&2
    exit 1
fi
# Nets and demand of everything that set-up fetched, and the generated scenarios, so that no container has to write there.
cp -r "$root/.deps/resco" "$deps/"
cp -r "$root/scenarios" "$destination/learner/opt/cross/"
for scenario in grid5x5 grid5x5-heavy grid5x5-light grid5x5-mid varied1 varied2 varied3 varied4 varied5 varied6; do
    "$release/cross" scenario fetch "$scenario" >&2
done
cp -r "$root/.deps/generated" "$deps/"
if [ -d "$root/.deps/scenarios" ]; then cp -r "$root/.deps/scenarios" "$deps/"; fi

# The authorities that this machine trusts: an object store is asked over TLS, and the base image may know none.
authorities=/etc/ssl/certs/ca-certificates.crt
if [ -e "$authorities" ]; then
    mkdir -p "$destination/learner/etc/ssl/certs"
    cp -L "$authorities" "$destination/learner/etc/ssl/certs/"
else
    echo "warning: this machine has no $authorities; the learner's image will use an object store over TLS only with a bundle that SSL_CERT_FILE names" >&2
fi

echo "collecting the actor: its program, SUMO"
program actor cross-actor
sumo="$destination/actor/opt/cross/.deps/sumo"
mkdir -p "$sumo/sumo/bin" "$sumo/eclipse_sumo.libs" "$sumo/system" "$sumo/sumo/data"
for tool in sumo netconvert; do
    cp "$root/.deps/sumo/sumo/bin/$tool" "$sumo/sumo/bin/"
    for library in $(libraries "$root/.deps/sumo/sumo/bin/$tool"); do
        # X11 and GL, which SUMO links and never calls here, come along as bare libraries, because Debian's packages of
        # them bring a compiler of shaders.
        case "$library" in
        */eclipse_sumo.libs/*) take "$library" "$sumo/eclipse_sumo.libs" ;;
        *) is_runtime "$library" || take "$library" "$sumo/system" ;;
        esac
    done
done
for data in typemap xsd; do
    if [ -d "$root/.deps/sumo/sumo/data/$data" ]; then cp -r "$root/.deps/sumo/sumo/data/$data" "$sumo/sumo/data/"; fi
done
du -sh "$destination/learner" "$destination/actor"
