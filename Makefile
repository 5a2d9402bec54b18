# make demo | test | check | bench | docs | pins | clean: each sets up .venv first, when needed.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready

.PHONY: demo test check bench docs pins clean

demo: $(READY)
	$(BIN)/aerobalance demo --out build/demo

test: $(READY)
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n auto

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
