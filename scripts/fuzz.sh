#!/usr/bin/env bash
# Fuzzes one target after the other, guided by coverage (docs/fuzzing.md). Stable Rust and the C++ compiler of the set-up do.
#
#   scripts/fuzz.sh              every target, RUNS inputs each
#   scripts/fuzz.sh net routes   these
#   RUNS=1000000 SEED=1          inputs of each target; seed of the changes
#   FEATURES=guided scripts/fuzz.sh net    without the targets that link libtorch (a quicker build)
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

runs="${RUNS:-100000}" seed="${SEED:-1}"
target_dir="${CARGO_TARGET_DIR:-target}/fuzz"
host="$(rustc -vV | sed -n 's/^host: //p')"
features=(--features guided)
[ -z "${FEATURES:-}" ] || features=(--no-default-features --features "$FEATURES")

# Coverage of every branch and comparison, and the checks that a release leaves out. With a target of their own the flags
# leave build scripts and macros alone.
RUSTFLAGS="-Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 \
-Cllvm-args=-sanitizer-coverage-inline-8bit-counters -Cllvm-args=-sanitizer-coverage-pc-table \
-Cllvm-args=-sanitizer-coverage-trace-compares -Cdebug-assertions -Coverflow-checks -Ccodegen-units=1" \
    "${CARGO:-cargo}" build --release --package cross-fuzz --bin cross-fuzz "${features[@]}" \
    --target "$host" --target-dir "$target_dir"
program="$target_dir/$host/release/cross-fuzz"

targets=("$@")
[ ${#targets[@]} -gt 0 ] || mapfile -t targets < <(sed -n 's/^ *name: "\(.*\)",$/\1/p' fuzz/src/targets/mod.rs)

for target in "${targets[@]}"; do
    # What is found stays here; a failing input is left in failures/ and belongs into fuzz/corpus/ with its fix.
    found="$target_dir/corpus/$target" failures="$target_dir/failures/$target/" written="$target_dir/written/$target"
    mkdir -p "$found" "$failures" "$written"
    committed="fuzz/corpus/$target"
    [ -d "$committed" ] || committed="$written"
    echo "=== $target: $runs inputs, seed $seed"
    # A watch on memory as a whole and on time as the clock shows it, beside the program's own and tighter ones. The longest
    # input of all targets; each keeps to its own.
    CROSS_FUZZ_TARGET="$target" CROSS_FUZZ_SEEDS="$written" "$program" -runs="$runs" -seed="$seed" -max_len=8192 \
        -timeout=20 -malloc_limit_mb=512 -rss_limit_mb=2048 -reload=0 -print_final_stats=1 \
        -artifact_prefix="$failures" "$found" "$written" "$committed" \
        > "$target_dir/$target.log" 2>&1 || { tail -n 40 "$target_dir/$target.log"; exit 1; }
    grep -E "^(#[0-9]+[[:space:]]+DONE|Done |stat::)" "$target_dir/$target.log"
done
