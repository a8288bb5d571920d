# One command each; CI runs exactly these. Every target does its own set-up from a fresh clone.
SHELL := /bin/bash
.DEFAULT_GOAL := help
PYTHON ?= python3
PORT ?= 8000
DATA ?= data
MACHINES ?= 1
# On a terminal uv shows its progress; in a log it is silent.
QUIETLY := $(shell [ -t 2 ] || echo --quiet)
BIN := .venv/bin
STAMP := build/stamps
export UV_PYTHON_DOWNLOADS = never
export NPM_CONFIG_UPDATE_NOTIFIER = false
# Compiled modules are kept, wherever the shell forbids it: every process of a test starts in half the time.
export PYTHONDONTWRITEBYTECODE =
export UV_PYTHON = $(PYTHON)

.PHONY: accuracy coverage mutation help setup runtime web demo test test-long quick web-test python-test live link first-start browser-test e2e check lint types types-check tables spec bench clean
help:  ## Show this list
	@grep -hE '^[a-z0-9-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 10

# --- set-up ---------------------------------------------------------------------------------------
.tools/bin/uv:
	@echo "== installing uv into .tools (once)"
	@$(PYTHON) -c 'import sys; v = sys.version_info[:2]; sys.exit(0 if v >= (3, 11) else f"Python 3.11 or newer is needed, {sys.executable} is {v[0]}.{v[1]}; run: make PYTHON=/path/to/python3.12 ...")'
	@$(PYTHON) -m venv .tools
	@.tools/bin/python -m pip --quiet --disable-pip-version-check install 'uv==0.13.9'

$(STAMP)/python: .tools/bin/uv pyproject.toml uv.lock
	@echo "== installing Python packages into .venv (once; 1 to 3 minutes)"
	@.tools/bin/uv sync --frozen --all-extras $(QUIETLY)
	@mkdir -p $(@D) && touch $@

setup: $(STAMP)/python  ## Python environment with the command .venv/bin/downrange

runtime: .tools/bin/uv  ## Only what a machine's computer needs: .venv/bin/downrange machine
	@echo "== installing the runtime's packages into .venv"
	@.tools/bin/uv sync --frozen --no-dev --quiet

WEB_SOURCES := $(shell find web -type f -not -path '*/node_modules/*' -not -path '*/dist/*' 2>/dev/null)
$(STAMP)/web: $(STAMP)/python $(WEB_SOURCES)
	@echo "== installing the console's packages into web/node_modules (once; about a minute)"
	@# Not `npm ci`: it refuses a lock file from a registry that leaves out other platforms' packages.
	@$(BIN)/python scripts/node.py npm --prefix web install --no-save --no-audit --no-fund --loglevel=error
	@echo "== building the console into web/dist"
	@$(BIN)/python scripts/node.py npm --prefix web run --silent build -- --logLevel warn
	@mkdir -p $(@D) && touch $@

web: $(STAMP)/web  ## Build the console

$(STAMP)/browser: $(STAMP)/python
	@$(BIN)/python scripts/browser.py
	@mkdir -p $(@D) && touch $@

# --- use ------------------------------------------------------------------------------------------
demo: $(STAMP)/python $(STAMP)/web  ## Server, virtual machines and console: make demo PORT=8000 DATA=data MACHINES=1
	@echo "== starting the demo"
	@$(BIN)/downrange demo --port $(PORT) --data $(DATA) --machines $(MACHINES)

# --- checks ---------------------------------------------------------------------------------------
lint: $(STAMP)/python
	@echo "== lint, types, layers, spec"
	@$(BIN)/ruff check . && $(BIN)/ruff format --check .
	@$(BIN)/pyright
	@$(BIN)/lint-imports --no-cache
	@$(BIN)/downrange spec --check
	@$(BIN)/python -m scripts.result_tables --check

check: lint types-check  ## Lint, types, layers, generated files; no tests

types-check: $(STAMP)/web
	@$(BIN)/python scripts/node.py npm --prefix web run --silent check
	@echo "== generated API client"
	@$(BIN)/downrange openapi --out build/openapi.json > build/openapi.log
	@cmp build/openapi.json web/openapi.json || { echo "web/openapi.json is old: run make types"; exit 1; }
	@$(BIN)/python scripts/node.py npm --prefix web run --silent types -- ../build/schema.ts > build/types.log
	@cmp build/schema.ts web/src/api/schema.ts || { echo "web/src/api/schema.ts is old: run make types"; exit 1; }
	@$(BIN)/python scripts/vocabulary.py build/vocabulary.ts
	@cmp build/vocabulary.ts web/src/api/vocabulary.ts || { echo "web/src/api/vocabulary.ts is old: run make types"; exit 1; }

# Three jobs on two cores: some mostly wait. Each job's output is shown when it ends.
BESIDE := $(MAKE) --no-print-directory --jobs 3 --output-sync=target

test: setup  ## All checks and tests of every commit, those of the whole demo in a real browser included
	@$(BESIDE) check web-test $(STAMP)/browser
	@# Tests of the link mostly wait; a demo's first start measures on one core.
	@$(BESIDE) python-test link first-start
	@$(MAKE) --no-print-directory browser-test

# Kill sweeps, a training that is killed, a further router, three machines through a whole rollout.
test-long: $(STAMP)/web $(STAMP)/browser  ## Tests too long for every commit: before a release
	@$(BIN)/pytest -m long --durations 12

quick: web-test python-test  ## Tests of single parts, console included

web-test: $(STAMP)/web
	@$(BIN)/python scripts/node.py npm --prefix web run --silent test

# Three processes on two cores: those of the server's tests mostly wait.
python-test: $(STAMP)/web
	@nice $(BIN)/pytest -n 3 --dist loadfile -m "not long" --durations 12 --ignore tests/e2e --ignore tests/link

live: link first-start browser-test  ## Machines at 100 Hz on a real link that is cut and killed; then e2e

link: $(STAMP)/python
	@$(BIN)/pytest -m "not long" --durations 12 tests/link

first-start: $(STAMP)/web
	@$(BIN)/pytest tests/e2e/test_first_start.py

# Two demos and two browsers: each waits for its machine, or draws on one core. Where a button is held they run
# one by one, on one demo: a second browser or a diagnosis beside them delays the signal of the hold.
HOLD_TESTS := $(addprefix tests/e2e/test_,click_to_throw.py keyboard.py touch.py work.py zone_page.py)
browser-test: $(STAMP)/web $(STAMP)/browser
	@$(BIN)/pytest --durations 6 $(HOLD_TESTS)
	@$(BIN)/pytest -n 2 --dist loadfile -m "not long" --durations 12 --ignore tests/e2e/test_first_start.py \
		$(addprefix --ignore ,$(HOLD_TESTS)) tests/e2e

e2e: first-start browser-test  ## The whole demo in a real browser: click, preview, hold, impact, STOP

types: $(STAMP)/python  ## Regenerate web/src/api from the server's OpenAPI description and the report's vocabulary
	@$(BIN)/downrange openapi --out web/openapi.json
	@$(BIN)/python scripts/node.py npm --prefix web run --silent types -- src/api/schema.ts
	@$(BIN)/python scripts/vocabulary.py web/src/api/vocabulary.ts

SAFETY_FILES := runtime/control/safety.py,runtime/guard/*,runtime/throw/*,runtime/control/control_loop.py,runtime/process/machine_control.py
SAFETY_TESTS := tests/runtime/control/test_safety.py tests/runtime/control/test_safety_permission.py \
	tests/runtime/control/test_control_loop.py \
	tests/runtime/process/test_machine_control.py tests/runtime/guard tests/runtime/throw

coverage: $(STAMP)/python  ## Branch coverage of gate, guard, throw protocol and their callers; fails below 100 %
	@$(BIN)/coverage run --branch --data-file=build/coverage --include='$(SAFETY_FILES)' -m pytest -q $(SAFETY_TESTS)
	@$(BIN)/coverage report --data-file=build/coverage --show-missing --fail-under=100

accuracy: $(STAMP)/python  ## Tests of what the diagnosis tells apart, too slow for every commit
	@$(BIN)/pytest -n 2 --dist loadfile benchmarks/accuracy

mutation: $(STAMP)/python  ## Change the safety code in small ways; lists the changes that no test notices
	@$(BIN)/python -m benchmarks.mutation

tables: $(STAMP)/python  ## Regenerate the documents' tables from benchmarks/results and the effects
	@$(BIN)/python -m scripts.result_tables

spec: $(STAMP)/python  ## Regenerate machine/spec.json from machine/m545.xml
	@$(BIN)/downrange spec

bench: $(STAMP)/python  ## Measure everything in benchmarks/ and write benchmarks/results/
	@for file in $(filter-out benchmarks/result_file.py,$(wildcard benchmarks/*.py)); do echo "== $$file"; $(BIN)/python -m benchmarks.$$(basename $$file .py) || exit 1; done

clean:  ## Remove everything that set-up made
	@rm -rf .venv .tools build web/dist web/node_modules
