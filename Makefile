# Everything a person does with this checkout. `make help` lists it.
#
# Set-up (SUMO, libtorch, maps) is scripts/setup.py and goes to .deps/; the build goes to target/, runs to runs/.

PYTHON ?= python3
CARGO ?= cargo
ARGS ?=

TARGET := $(or $(CARGO_TARGET_DIR),target)
# The set-up decides here whether a LIBTORCH or SUMO_HOME of the user's fits, and unsets it if not. What the user's own
# cargo settings say about places is overruled: train and the tests look for the programs in $(TARGET)/release.
IN_ENV := . .deps/environment.sh && unset CARGO_BUILD_TARGET && export CARGO_BUILD_BUILD_DIR='$(TARGET)' &&
IN_TARGET := --target-dir '$(TARGET)'

.DEFAULT_GOAL := help
.PHONY: help setup build train baselines results towns test test-setup fuzz faults soak images verify fix clean distclean

help: ## Show this list
	@echo 'Two commands:  make train   and   make test'
	@echo
	@sed -n 's/^\([a-z-]*\):[^#]*## \(.*\)/  make \1|\2/p' Makefile | awk -F'|' '{ printf "%-18s %s\n", $$1, $$2 }'
	@echo
	@echo '  ARGS="..."         options passed on by train, baselines, results, towns, faults and soak, as in: make train ARGS="--updates 500 --scenario grid4x4"'
	@echo '  CROSS_TORCH=cuda   set up libtorch with its CUDA libraries instead of the CPU ones'
	@echo '  CROSS_CACHE=DIR    keep downloaded wheels in DIR, for other checkouts'

setup: ## Fetch SUMO, libtorch and the RESCO maps into .deps/ (only what is missing)
	@command -v $(PYTHON) >/dev/null || { echo 'error: $(PYTHON) was not found: install Python 3.9 or newer, or name it with make PYTHON=...' >&2; exit 1; }
	@CARGO='$(CARGO)' $(PYTHON) scripts/setup.py

build: setup ## Set up and build the binaries in release: target/release/cross, cross-learner, cross-actor
	@$(IN_ENV) $(CARGO) build $(IN_TARGET) --release --workspace --bins
	@test -x '$(TARGET)/release/cross' || { echo 'error: the build left no $(TARGET)/release/cross: take build.target out of your cargo configuration (~/.cargo/config.toml), it puts programs elsewhere' >&2; exit 1; }

train: build ## Train CROSS on real SUMO, then compare it with Fixed-Time and Max-Pressure
	@# exec: a signal that make passes on reaches the run itself, not a shell that would leave it behind.
	@$(IN_ENV) exec '$(TARGET)/release/cross' train $(ARGS)

baselines: build ## Evaluate the rules on the eight scenarios and write docs/baselines.md (an hour of CPU time; resumable)
	@$(IN_ENV) exec '$(TARGET)/release/cross' baselines --markdown docs/baselines.md $(ARGS)

results: build ## Evaluate pretrained/default beside the rules and write docs/results.md (an hour of CPU time; resumable)
	@$(IN_ENV) exec '$(TARGET)/release/cross' results --policy pretrained/default --markdown docs/results.md --pictures docs/images/results $(ARGS)

towns: build ## The same on RESCO's six maps of real towns: docs/towns.md (a quarter of an hour of CPU time; resumable)
	@$(IN_ENV) exec '$(TARGET)/release/cross' results $(addprefix --scenario ,cologne1 cologne3 cologne8 ingolstadt1 ingolstadt7 ingolstadt21) --policy pretrained/default --markdown docs/towns.md --pictures docs/images/towns $(ARGS)

test: build test-setup ## Every test: set-up, documentation, units, and whole clusters with real SUMO
	@$(IN_ENV) $(CARGO) test $(IN_TARGET) --release --workspace

test-setup: setup ## The tests of the set-up and the documentation alone (quick)
	@$(PYTHON) -B -m unittest discover --quiet --buffer --start-directory scripts/tests --top-level-directory scripts

fuzz: setup ## Fuzz every reader, guided by coverage (TARGETS: which, RUNS: inputs of each; docs/fuzzing.md)
	@$(IN_ENV) CARGO='$(CARGO)' CARGO_TARGET_DIR='$(TARGET)' scripts/fuzz.sh $(TARGETS)

faults: build ## Break a cluster 200 times in a row, as root (docs/faults.md; ARGS="--faults 50 --seed 7")
	@$(IN_ENV) $(CARGO) run $(IN_TARGET) --quiet --release -p cross-tests --example faults -- strike $(ARGS)

soak: build ## Watch the learner's memory for half an hour, as root (ARGS="--minutes 60")
	@$(IN_ENV) $(CARGO) run $(IN_TARGET) --quiet --release -p cross-tests --example faults -- soak $(ARGS)

images: build ## The container images cross-learner and cross-actor, from this build (BUILDER_IMAGE, BASE_IMAGE: other bases)
	@command -v docker >/dev/null || { echo 'error: docker was not found; docs/cluster.md tells what a cluster needs' >&2; exit 1; }
	@CARGO_TARGET_DIR='$(TARGET)' deploy/docker/images.sh

verify: setup ## Formatting, lints, documentation, licences; writes nothing outside target/
	$(CARGO) fmt --all --check
	@$(IN_ENV) $(CARGO) clippy $(IN_TARGET) --locked --release --workspace --all-targets -- -D warnings
	@$(IN_ENV) RUSTDOCFLAGS='-D warnings' $(CARGO) doc $(IN_TARGET) --locked --release --workspace --no-deps
	@if $(CARGO) deny --version >/dev/null 2>&1; then $(CARGO) deny --all-features check bans licenses sources; \
	else echo 'skipped: licences and sources of the dependencies; to check them: cargo install --locked cargo-deny'; fi

fix: setup ## Format, and let clippy repair what it can
	$(CARGO) fmt --all
	@$(IN_ENV) $(CARGO) clippy $(IN_TARGET) --release --workspace --all-targets --fix --allow-dirty --allow-staged

clean: ## Remove what the build made (target/)
	$(CARGO) clean $(IN_TARGET)

distclean: clean ## Remove the set-up too (.deps/); runs/ stays
	rm -rf .deps
