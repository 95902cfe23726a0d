# make demo   the whole chain on this machine, about 20 s
# make test   everything that must hold: style, types, imports, tests
# make test-vcan  the tests on a real CAN kernel, a guest's where this machine has none
# make setup  the environment both use, in .venv

PYTHON ?= python3
BIN := .venv/bin
# What the demo is given, for example: make demo ARGS="--seconds 10 --objects golf-ball"
ARGS ?=

.PHONY: setup demo test test-vcan check loop

setup: .venv/.installed

.venv/.installed: pyproject.toml
	@test -x $(BIN)/python || $(PYTHON) -m venv .venv
	@echo "installing into .venv"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[test]"
	@touch $@

demo: setup
	@$(BIN)/skin demo $(ARGS)

test: check
	$(BIN)/pytest

test-vcan: setup
	tests/vcan/run

# The quick loop while working: no slow tests.
loop: setup
	$(BIN)/pytest -q -m "not slow"

check: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
