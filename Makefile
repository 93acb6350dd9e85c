# The commands of the project. Each makes the virtual environment it needs, from the
# pinned and hashed lock files; only python3 (3.11 or newer) and make are assumed.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --quiet --disable-pip-version-check
# uv takes seconds for what takes pip minutes. Where uv fails, as with an index that only pip.conf names, pip installs.
INSTALL = @$(BIN)/uv pip install --quiet --python $(BIN)/python --compile-bytecode --require-hashes -r $(1) 2>/dev/null || \
  $(PIP) install --require-hashes -r $(1)
PORT ?= 8000

# Modules are compiled once, not by each process that a test starts, whatever the environment says.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo serve test collect all-tests soak soak-patterns image-check lint kernels bench lock format clean

demo: $(VENV)/installed ## replay five minutes of recorded flights and find events in them
	@$(BIN)/dyknow demo

serve: $(VENV)/installed ## leave the service running with the same flights replaying
	@$(BIN)/dyknow serve --port $(PORT) --flights

# Two more at work than there are cores: many tests wait. A worker that is done takes tests from the others.
PYTEST := $(BIN)/pytest -n $$(( $$(nproc) + 2 )) --dist worksteal

# How much of each law's examples: CI has a quarter of an hour. `make soak` draws all, several times.
SHARE ?= 0.15

# The loops are compiled once, and the assertions of the tests rewritten once, before each worker would do it.
test: $(VENV)/installed-dev ## everything that CI runs
	$(MAKE) --no-print-directory -j2 kernels collect
	$(MAKE) --no-print-directory -j2 image-check all-tests
	$(MAKE) --no-print-directory -j2 sweep-reused sweep-retired

collect: lint
	@$(BIN)/pytest --collect-only -qq > $(VENV)/collected || { cat $(VENV)/collected; exit 1; }

all-tests:
	$(PYTEST) --share=$(SHARE) --hypothesis-profile=ci

# Laws that hold as well where terms are forgotten at every chance (tests/conftest.py).
sweep-%:
	$(BIN)/pytest -n 2 --dist worksteal $(SWEPT) --sweeps=$* --share=0.01 --hypothesis-profile=ci
SWEPT := $(addprefix tests/laws/,$(addprefix continuous/test_,continuous.py algebra.py patterns.py) streams/test_event_time.py $(addprefix engine/test_,shared_requests.py engine.py) converters/test_ntriples.py)

ROUNDS ?= 3
SECONDS ?= 600
soak: $(VENV)/installed-dev ## what takes long: a service under use, a thousand deaths, 200,000 random windows, ROUNDS of all laws, 230,000 random patterns
	$(BIN)/python bench/service/soak.py $(SECONDS)
	$(BIN)/python tests/laws/reasoning/mutants.py
	DYKNOW_KILLS=1000 $(BIN)/pytest -n 0 -s tests/service/durability/test_kill.py
	DYKNOW_BOUNDS=1 $(PYTEST) tests/service/test_openapi_fuzz.py
	DYKNOW_QUERY_WINDOWS=200000 DYKNOW_QUERY_SEED=$$(date +%s) $(PYTEST) tests/laws/continuous/test_differential.py
	for round in $$(seq $(ROUNDS)); do $(PYTEST) tests/laws --hypothesis-profile=default || exit 1; done
	$(MAKE) --no-print-directory soak-patterns

# All that a pattern is: each language against its meaning, each evaluator against its definition (rows in order and in any
# order, optional parts, repetition, over many spans of a match), partial matches, and samples of several streams.
PATTERN_LAWS := $(patsubst %,tests/laws/reasoning/patterns/test_%.py,chronicle epsparql sase pattern_joins pattern_repetition pattern_runs pattern_trends partial_matches recognition)
soak-patterns: $(VENV)/installed-dev ## 230,000 random patterns against their definitions: 20 times the examples of their laws
	$(PYTEST) $(PATTERN_LAWS) --share=20 --hypothesis-profile=default

image-check: ## what the Dockerfile does, as a script in an empty folder
	sh docker/check

lint: $(VENV)/installed-dev
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy -p dyknow
	$(BIN)/lint-imports

kernels: $(VENV)/installed-dev ## compile the loops of numba into its cache, by two processes
	@$(call COMPILE,backwards=True) & $(call COMPILE) && wait $$!
COMPILE = $(BIN)/python -c 'import dyknow.service.app; from dyknow.streams.jit import compile_all; compile_all($(1))'

bench: $(VENV)/installed-dev ## the performance tables of docs/explanation/performance.md
	$(BIN)/python bench/run.py

format: $(VENV)/installed-dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

lock: ## renew the lock files from the ranges in pyproject.toml
	$(PYTHON) -m venv $(VENV) && $(PIP) install uv
	echo uv | $(BIN)/uv pip compile - $(LOCK) -o requirements-uv.lock
	$(BIN)/uv pip compile pyproject.toml --group build $(LOCK) -o requirements.lock
	$(BIN)/uv pip compile pyproject.toml --group build --group dev --extra arrow --extra px4 --extra mcap --extra pandas --extra rosbag $(LOCK) -o requirements-dev.lock
LOCK := --quiet --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-emit-find-links --no-header

$(VENV)/installed: requirements.lock requirements-uv.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	  || { echo "DyKnow needs Python 3.11 or newer; name one with: make $(MAKECMDGOALS) PYTHON=python3.12"; exit 1; }
	@echo "installing DyKnow into $(VENV) (once) ..."
	@$(PYTHON) -m venv $(VENV)
	@$(PIP) install --require-hashes -r requirements-uv.lock || true
	$(call INSTALL,requirements.lock)
	@$(PIP) install --no-deps --no-build-isolation --editable .
	@touch $@

$(VENV)/installed-dev: requirements-dev.lock $(VENV)/installed
	@echo "installing the development tools into $(VENV) (once) ..."
	$(call INSTALL,requirements-dev.lock)
	@touch $@

clean:
	rm -rf $(VENV) build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
