# Every target sets up what it needs: system libraries, .venv, the package.
.DEFAULT_GOAL := help
SHELL := /bin/sh
PYTHON ?= python3
BIN := .venv/bin
READY := .venv/.ready
ARTIFACT ?=
HOST ?= 127.0.0.1
PORT ?= 8000

.PHONY: help setup demo test check serve fit clean

help: ## Say what each target does
	@grep -E '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*## /\t/' | expand -t 10

setup: $(READY) ## Set up .venv and system libraries

$(READY): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "Python 3.11 or newer is needed; set PYTHON=/path/to/python3.11" >&2; exit 1; }
	@scripts/system_libraries.sh
	@test -x $(BIN)/python || $(PYTHON) -m venv .venv
	@echo "Installing packages into .venv (a few minutes the first time)"
	@$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@touch $(READY)

demo: $(READY) ## Train for two minutes, export, serve, register an unseen pair over HTTP
	@$(BIN)/python examples/demo.py

test: $(READY) ## Run the tests
	@$(BIN)/python -m pytest $(ARGS)

check: $(READY) ## Lint, format check, types and import directions
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy
	@$(BIN)/lint-imports

serve: $(READY) ## Serve the shipped artifact, or ARTIFACT=DIR, on HOST and PORT
	@$(BIN)/equivalign serve $(if $(ARTIFACT),--artifact $(ARTIFACT)) --host $(HOST) --port $(PORT)

fit: $(READY) ## Train by CONFIG=configs/quickstart.yaml
	@$(BIN)/equivalign fit -c $(or $(CONFIG),configs/quickstart.yaml)

clean: ## Remove .venv and everything that was generated
	rm -rf .venv runs demo build dist *.egg-info .mypy_cache .pytest_cache .ruff_cache
