# Every target sets up what it needs: system packages, .venv, this package.
.DEFAULT_GOAL := help
SHELL := /bin/sh
PYTHON ?=
BIN := .venv/bin
READY := .venv/.ready
# Waiting threads give the core away; see app/__init__.py.
export OMP_WAIT_POLICY ?= passive
ARTIFACT ?=
HOST ?= 127.0.0.1
PORT ?= 8000

.PHONY: help setup demo test check serve fit artifact clean

help: ## Say what each target does
	@grep -E '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*## /\t/' | expand -t 8

setup: $(READY) ## Set up system packages and .venv; PYTHON=PATH chooses the interpreter

$(READY): pyproject.toml constraints.txt
	@PYTHON="$(PYTHON)" scripts/set_up.sh

demo: $(READY) ## Train for two minutes at most, export, serve, register an unseen pair over HTTP
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

artifact: $(READY) ## Train the shipped artifact from nothing into runs/artifact; about two hours on two cores
	@PATH="$(CURDIR)/$(BIN):$$PATH" scripts/train_artifact.sh

clean: ## Remove .venv and everything that was generated
	rm -rf .venv runs demo build dist *.egg-info .mypy_cache .pytest_cache .ruff_cache .import_linter_cache
