# make demo | test | soak | check | bench | faults | coverage | mutants | docs | pins | clean: each sets up .venv first,
# when needed.
# Random numbers of tests are the same at every `make test`. `make soak` runs the tests with new ones, ROUNDS times;
# `make test SEED=123` runs them with the seed of a round that failed.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
TEST_READY := $(VENV)/.ready-test
DOCS_READY := $(VENV)/.ready-docs
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile
# on all processors, where pip takes one, and without the libraries' own tests, which are half of all; it must be done
# before the tests, some of which limit the size of files: Python then keeps a part of what it compiles itself
BYTECODE := $(BIN)/python -m compileall -qq -j 0 -x '/tests/' $(VENV)/lib src || true
# without the bytecode of tests and program every process of the tests would make it anew
export PYTHONDONTWRITEBYTECODE :=
COMPILED := build/.compiled
KERNELS := $(shell find src -name '_*kernels.py') src/aerobalance/recording/compiled.py
ROUNDS ?= 3
BENCH := OMP_NUM_THREADS=1 $(BIN)/python -m pytest tests/benchmarks -o addopts="" --benchmark-disable -q
# one more than processors: tests of the command line and of pages wait for other processes a third of their time
WORKERS := $(shell $(PYTHON) -c "import os; print((os.cpu_count() or 1) + 1)")
TEST := OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n $(WORKERS) --dist worksteal

.PHONY: demo test soak check types lint bench faults coverage mutants docs pins clean prepared

demo: $(COMPILED)
	$(BIN)/aerobalance demo --out build/demo

test: $(TEST_READY) $(COMPILED)
	$(TEST)$(if $(SEED), --seed $(SEED))

# Loops compiled and the bytecode of all tests made once: otherwise each process of the tests makes it.
prepared: $(TEST_READY) $(COMPILED)
	$(BIN)/python -m pytest --collect-only -p no:xdist > build/collected.txt

soak: $(TEST_READY) $(COMPILED)
	@failed=""; \
	for round in $$(seq $(ROUNDS)); do \
	  seed=$$($(BIN)/python -c "import secrets; print(secrets.randbits(32))"); \
	  echo "round $$round of $(ROUNDS): seed $$seed (again: make test SEED=$$seed)"; \
	  $(TEST) --seed $$seed || { [ $$? -eq 1 ] || exit 2; failed="$$failed $$seed"; }; \
	done; \
	if [ -n "$$failed" ]; then echo "failed with the seeds:$$failed (again: make test SEED=...)"; exit 1; fi; \
	echo "no failure in $(ROUNDS) rounds"

check: types lint

types: $(TEST_READY)
	$(BIN)/mypy

lint: $(TEST_READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports

# What measures time comes last, with nothing beside it.
bench: $(TEST_READY) $(COMPILED)
	rm -f build/benchmarks.json
	@failed=0; \
	$(BENCH) -n auto --dist worksteal -m "not alone" || failed=1; \
	$(BENCH) -m alone || failed=1; \
	$(BIN)/python docs/benchmarks.py; \
	exit $$failed

# Records that are wrong in one thing each: what their forces say of it. SEEDS of each, some ten minutes for two.
faults: $(TEST_READY)
	cd tests && OMP_NUM_THREADS=1 ../$(BIN)/python -m faults.trials --seeds $(or $(SEEDS),2) --out ../build/faults.json
	$(BIN)/python docs/faults.py

# Which lines and branches of the core the tests run; those of readers and recorders, and tests that leave no room for a
# file, are left out.
coverage: $(TEST_READY) $(COMPILED)
	rm -f build/coverage*
	OMP_NUM_THREADS=1 $(BIN)/python -m coverage run -m pytest -n auto --dist worksteal --ignore=tests/acquire \
	  --ignore=tests/browser --ignore=tests/io/test_hdf5_disk.py
	$(BIN)/python -m coverage combine --quiet
	$(BIN)/python -m coverage report --skip-covered --sort=cover

# COUNT faults put into the core one at a time, drawn by SEED: whether its tests notice.
mutants: $(TEST_READY) $(COMPILED)
	OMP_NUM_THREADS=1 $(BIN)/python tests/mutants.py --count $(or $(COUNT),150) --seed $(or $(SEED),1)

# The examples are run for their pages, with a loop compiled for none of them.
docs: $(DOCS_READY) $(COMPILED)
	OMP_NUM_THREADS=1 $(BIN)/sphinx-build -W --keep-going -b html docs build/docs

# Pins by what they are for, each with all that it needs and with hashes, and all of one resolution; this needs uv.
# Versions stay where they can; `make pins UPGRADE=--upgrade` takes the newest.
COMPILE := uv pip compile --quiet --universal --python-version 3.11 --no-emit-index-url --no-header
HASHED := $(COMPILE) --generate-hashes --no-annotate -c build/pins.txt

pins:
	mkdir -p build
	sed -n 's/ \\$$//; /^[a-z].*==/p' requirements/*.txt | sort -u > build/pins.txt
	$(COMPILE) $(UPGRADE) --extra dev --group build pyproject.toml -o build/pins.txt
	$(HASHED) pyproject.toml -o requirements/runtime.txt
	$(HASHED) --extra test pyproject.toml -o requirements/test.txt
	$(HASHED) --extra docs pyproject.toml -o requirements/docs.txt
	$(HASHED) --group build -o requirements/build.txt

clean:
	rm -rf $(VENV) build docs/examples

$(READY): requirements/runtime.txt requirements/build.txt pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(INSTALL) --require-hashes -r requirements/runtime.txt -r requirements/build.txt
	$(INSTALL) --no-build-isolation --no-deps -e .
	$(BYTECODE)
	touch $@

# Loops are compiled again where one has changed, before tests run that measure time or what is said.
$(COMPILED): $(READY) $(KERNELS)
	mkdir -p build
	$(BIN)/python -c "from aerobalance.app.first_use import compile_all; compile_all()"
	touch $@

$(TEST_READY): $(READY) requirements/test.txt
	$(INSTALL) --require-hashes -r requirements/test.txt
	$(BYTECODE)
	touch $@

$(DOCS_READY): $(READY) requirements/docs.txt
	$(INSTALL) --require-hashes -r requirements/docs.txt
	touch $@
