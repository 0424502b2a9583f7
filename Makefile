# Everything a developer does with Skyline. `make` alone lists it.

PYTHON ?= python3
VENV := .venv
IN_VENV := $(VENV)/bin
INSTALLED := $(VENV)/.installed
# The longest first.
TESTS := tests/cli tests/gl tests/bench tests/unit tests/web
# Tests use a core for the most part, and wait now and then: four folders run at once on two cores,
# and the results of each are printed when it is done.
AT_ONCE := --jobs=4 --output-sync --keep-going --no-print-directory

.DEFAULT_GOAL := help
.PHONY: help setup demo test test-all $(TESTS) check docs clean

help: ## List the targets
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/  make \1\t\2/p' $(MAKEFILE_LIST) | expand -t 16

setup: $(INSTALLED) ## Install system packages (as root), a virtual environment, Skyline and its benchmarks

demo: setup ## Build a store over a real DEM, match images to it, write out/demo
	$(IN_VENV)/python examples/demo.py --out out/demo

test: setup ## Run the tests but for the slowest; `make tests/gl` runs a folder of them
	$(MAKE) $(AT_ONCE) $(TESTS) CHOSEN='-m "not slow"'

test-all: setup ## Run all tests
	$(MAKE) $(AT_ONCE) $(TESTS)

$(TESTS): setup
	$(IN_VENV)/python -m pytest $(CHOSEN) $@

docs: setup ## Build the documentation into build/site, notebooks run; a broken link fails
	RUN_NOTEBOOKS=true NO_MKDOCS_2_WARNING=1 $(IN_VENV)/mkdocs build --strict

check: setup ## Lint, check format, types, imports, spelling and links of the documentation
	$(IN_VENV)/ruff check
	$(IN_VENV)/ruff format --check
	$(IN_VENV)/mypy
	$(IN_VENV)/lint-imports
	$(IN_VENV)/codespell
	NO_MKDOCS_2_WARNING=1 $(IN_VENV)/mkdocs build --strict

clean: ## Remove what the targets above made, except benchmark results
	rm -rf $(VENV) out/demo build dist
	rm -rf .mypy_cache .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(INSTALLED): pyproject.toml bench/pyproject.toml
	@$(PYTHON) .ci/system_packages.py
	$(PYTHON) -m venv $(VENV)
	$(IN_VENV)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]' --editable bench
	@touch $@
