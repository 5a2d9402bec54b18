# make demo | test | check | bench | docs | pins | clean: each sets up .venv first, when needed.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
TEST_READY := $(VENV)/.ready-test
DOCS_READY := $(VENV)/.ready-docs
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check

.PHONY: demo test check bench docs pins clean

demo: $(READY)
	$(BIN)/aerobalance demo --out build/demo

test: $(TEST_READY)
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n auto

check: $(TEST_READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(TEST_READY)
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest tests/benchmarks -o addopts="" --benchmark-disable -q

docs: $(DOCS_READY)
	$(BIN)/sphinx-build -W --keep-going -b html docs build/docs

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
	rm -rf $(VENV) build

$(READY): requirements/runtime.txt requirements/build.txt pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(INSTALL) --require-hashes -r requirements/runtime.txt -r requirements/build.txt
	$(INSTALL) --no-build-isolation --no-deps -e .
	# compiled here once, so that the first page does not wait for it
	$(BIN)/python -c "from aerobalance.monitor.engine import warm_up; warm_up()"
	touch $@

$(TEST_READY): $(READY) requirements/test.txt
	$(INSTALL) --require-hashes -r requirements/test.txt
	touch $@

$(DOCS_READY): $(READY) requirements/docs.txt
	$(INSTALL) --require-hashes -r requirements/docs.txt
	touch $@
