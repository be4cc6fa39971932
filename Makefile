# Two commands on a fresh clone: `make demo` and `make test`. Python 3.11+ and a Rust toolchain do.

PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
DEMO   := build/demo
RUST   := $(shell find rust -name '*.rs' -o -name Cargo.toml 2>/dev/null) Cargo.toml Cargo.lock

.PHONY: setup develop demo comparisons test cross instructions check bench claims docs wheel wheel-aarch64 sdist dist-check lock clean

setup: $(VENV)/.built

# Compiles most of the core while pip installs the packages. Their bytecode is compiled while maturin runs,
# because without write permission every run would compile it again.
$(VENV)/.installed: requirements-run.lock
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo 'strainwave needs Python 3.11 or later: make setup PYTHON=/path/to/python3.11'; exit 1; }
	@command -v cargo > /dev/null || { echo 'strainwave needs a Rust toolchain: https://rustup.rs'; exit 1; }
	cargo build --release --locked --quiet --lib \
	  -p strainwave-arms -p strainwave-numerics -p strainwave-statespace & core=$$!; \
	$(PYTHON) -m venv $(VENV) && \
	  $(BIN)/pip install --quiet --no-compile --disable-pip-version-check --require-hashes \
	    -r requirements-run.lock; \
	installed=$$?; wait $$core && exit $$installed
	@touch $@

$(VENV)/.built: $(VENV)/.installed pyproject.toml $(RUST)
	nice $(BIN)/python -m compileall -qq $(VENV)/lib python/strainwave & \
	VIRTUAL_ENV=$(abspath $(VENV)) $(BIN)/maturin develop --release --locked --quiet; \
	built=$$?; wait; exit $$built
	@touch $@

# The packages of tests, checks, benchmarks and documentation.
develop: setup $(VENV)/.develop

$(VENV)/.develop: requirements.lock $(VENV)/.installed
	$(BIN)/pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	@touch $@

demo: setup
	$(BIN)/python -m reproduction --out $(DEMO) $(DEMO_ARGS)

# Renews the pages of the comparisons and their images from ten seeds of both arms: about 25 minutes.
comparisons: setup
	for arm in soft stiff; do \
	  $(BIN)/python -m reproduction --arm $$arm --as-published --seeds 10 --figures \
	    --out build/comparisons/$$arm && \
	  cp build/comparisons/$$arm/images/comparisons/*.png docs/images/comparisons/ || exit 1; \
	done
	cp build/comparisons/soft/comparisons.md build/comparisons/soft/comparisons.json docs/
	cp build/comparisons/stiff/comparisons.md docs/comparisons-stiff.md

# Every run draws fresh cases and prints the seed that draws them again: make test SEED=...
# PROPTEST_CASES=20000 draws more of them.
ifndef SEED
SEED := $(shell od -An -N4 -tu4 /dev/urandom | tr -d ' ')
endif

# One process of tests more than cores: some tests wait for processes that they start. Python keeps the
# compiled tests even where the environment forbids it: they save each process 5 s in later runs.
WORKERS = $(shell $(PYTHON) -c 'import os; print(min(os.cpu_count() or 1, 8) + 1)')

test: develop
	@echo 'cases drawn with SEED=$(SEED); again: make test SEED=$(SEED)'
	PROPTEST_RNG_SEED=$(SEED) cargo test --release --workspace --exclude strainwave-python --locked --quiet
	PYTHONDONTWRITEBYTECODE= OPENBLAS_NUM_THREADS=1 $(BIN)/pytest -q -n $(WORKERS) --dist loadfile \
	  --hypothesis-profile=fresh --hypothesis-seed=$(SEED)

# The same compiler for both processors, with a standard library for aarch64: packages of Debian,
# which .ci/run lists. Tests are static programs, because in the emulator threads of others hang.
CROSS := aarch64-unknown-linux-gnu
cross instructions wheel-aarch64: export RUSTC := /usr/bin/rustc
cross instructions wheel-aarch64: export CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER := aarch64-linux-gnu-gcc
cross: export CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_RUNNER := qemu-aarch64-static
cross: export CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_RUSTFLAGS := -C target-feature=+crt-static

# Tests of the core for aarch64 in an emulator, with fewer drawn cases, and without those that take
# minutes there.
SLOW := derivatives_match methods_agree order_is_four energy_balance_holds_with_every_effect
cross:
	PROPTEST_CASES=8 cargo test --release --locked --quiet --target $(CROSS) -p strainwave-core \
	  -p strainwave-numerics -p strainwave-statespace -p strainwave-arms --lib --tests \
	  -- $(SLOW:%=--skip %)

# Counts the instructions of a step on aarch64 and x86-64.
instructions: develop
	$(BIN)/python -m benchmarks.instructions

check: develop
	cargo fmt --all --check
	cargo clippy --workspace --all-targets --locked --quiet -- -D warnings
	$(BIN)/ruff format --check
	$(BIN)/ruff check
	$(BIN)/ruff check --quiet --preview --select PLW1514 python benchmarks  # Windows has other encodings
	$(BIN)/mypy
	$(BIN)/mypy --platform win32 --cache-dir .mypy_cache/win32 python/strainwave
	$(BIN)/lint-imports
	$(BIN)/stubtest strainwave._core

bench: develop
	$(BIN)/python -m benchmarks

# Measures the documented numbers again and lists those that differ; CLAIMS=short takes three minutes, all take hours.
claims: develop
	$(BIN)/python -m benchmarks.claims $(if $(filter short,$(CLAIMS)),--short)

# Runs the notebooks; a warning is an error. Open build/docs/index.html.
docs: develop
	$(BIN)/python -m sphinx -b html -W --keep-going -q -d build/doctrees docs build/docs

wheel: $(VENV)/.installed
	$(BIN)/maturin build --release --locked --out dist

# A wheel for aarch64 on a machine with another processor.
wheel-aarch64: $(VENV)/.installed
	$(BIN)/maturin build --release --locked --target $(CROSS) --out dist

sdist: $(VENV)/.installed
	$(BIN)/maturin sdist --out dist

# Builds both, installs each into a fresh environment without an index, and runs the README's commands there.
dist-check: $(VENV)/.installed
	rm -rf dist
	$(MAKE) wheel sdist
	$(BIN)/python -m benchmarks.installation dist/*

# Refreshes the versions; needs `pip install pip-tools`. Hashes only: no address of a package index.
COMPILE := pip-compile --quiet --generate-hashes --strip-extras --no-header --no-emit-index-url \
  --no-emit-find-links --no-emit-trusted-host
lock:
	$(COMPILE) --upgrade --all-extras -o requirements.lock pyproject.toml
	grep -o '^[^ #]*==[^ ]*' requirements.lock > build-constraints.txt
	$(COMPILE) --no-annotate --extra build --extra serve -c build-constraints.txt -o requirements-run.lock pyproject.toml
	rm build-constraints.txt

clean:
	rm -rf $(VENV) target build dist
