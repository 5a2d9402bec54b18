# make demo | test | soak | check | bench | docs | pins | clean: each sets up .venv first, when needed.
# Random numbers of tests are the same at every `make test`. `make soak` runs the tests with new ones, ROUNDS times;
# `make test SEED=123` runs them with the seed of a round that failed.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
ROUNDS ?= 3
TEST := OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --dist worksteal

.PHONY: demo test soak check bench docs pins clean

demo: $(READY)
	$(BIN)/aerobalance demo --out build/demo

test: $(READY)
	$(TEST)$(if $(SEED), --seed $(SEED))

soak: $(READY)
	@failed=""; \
	for round in $$(seq $(ROUNDS)); do \
	  seed=$$($(BIN)/python -c "import secrets; print(secrets.randbits(32))"); \
	  echo "round $$round of $(ROUNDS): seed $$seed (again: make test SEED=$$seed)"; \
	  $(TEST) --seed $$seed || { [ $$? -eq 1 ] || exit 2; failed="$$failed $$seed"; }; \
	done; \
	if [ -n "$$failed" ]; then echo "failed with the seeds:$$failed (again: make test SEED=...)"; exit 1; fi; \
	echo "no failure in $(ROUNDS) rounds"

check: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(READY)
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest tests/benchmarks -o addopts="" --benchmark-disable -q

docs: $(READY)
	$(BIN)/sphinx-build -W --keep-going -b html docs build/docs

# The pins are compiled without index addresses; this needs uv.
pins:
	uv pip compile --quiet --universal --python-version 3.11 --no-emit-index-url --no-header --extra dev pyproject.toml -o requirements.txt

clean:
	rm -rf $(VENV) build

$(READY): requirements.txt pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-build-isolation --no-deps -e .
	# compiled here once, so that the first page does not wait for it
	$(BIN)/python -c "from aerobalance.monitor.engine import warm_up; warm_up()"
	touch $@
