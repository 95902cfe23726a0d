# make demo     the whole chain on this machine for 20 s; the first start takes one to two minutes more
# make test     everything that must hold: style, types, imports, tests
# make test-vcan  the tests on a real CAN kernel, a guest's where this machine has none
# make test-mcu   boards on emulated processors with CAN controllers of their own (docs/firmware.md)
# make test-containers  the skin in containers, on this machine's engine or one of its own (docs/containers.md)
# make lock     requirements.lock, the versions in the image, anew from pyproject.toml
# make wheels   the wheels of requirements.lock, for an image built without a network (docs/containers.md)
# make mutants  small faults put into the code that no test notices, a drawn sample (docs/develop.md)
# make figures  every picture of the README and of docs/, with today's code (ARGS="demo.png page.png" for some)
# make docs     the documents and the API as a site, in build/site/, without a network
# make setup    the environment of all of them, in .venv; make demo makes a smaller one, without the test tools

PYTHON ?= python3
BIN := .venv/bin
# What the demo is given, for example: make demo ARGS="--seconds 10 --objects golf-ball"
ARGS ?=
# The oldest Python that works, as pyproject.toml has it.
OLDEST := $(shell sed -n 's/^requires-python = ">=\(.*\)"/\1/p' pyproject.toml)
IS_NEW_ENOUGH := import sys; sys.exit(sys.version_info < tuple(map(int, "$(OLDEST)".split("."))))

.PHONY: setup demo test test-vcan test-mcu test-containers lock wheels mutants figures docs check loop

setup: .venv/.installed

# One stamp for what `make demo` needs and one for everything. Neither is touched when the install fails, and a .venv
# that cannot be used (wrong Python, no pip) is made anew.
define install
	@$(BIN)/python -c 'import pip; $(IS_NEW_ENOUGH)' 2>/dev/null || { \
		$(PYTHON) -c '$(IS_NEW_ENOUGH)' 2>/dev/null || { \
			echo "canskin needs Python $(OLDEST) or newer, and '$(PYTHON)' is $$($(PYTHON) --version 2>&1 | tail -n 1);" \
				"name another one: make PYTHON=python$(OLDEST) $(MAKECMDGOALS)" >&2; \
			exit 1; \
		}; \
		$(PYTHON) -m venv --clear .venv || { rm -rf .venv; exit 1; }; \
	}
	@echo "installing into .venv"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ./client --editable "$(1)"
endef

.venv/.installed: pyproject.toml client/pyproject.toml
	$(call install,.[test])
	@touch .venv/.demo $@

.venv/.demo: pyproject.toml client/pyproject.toml
	$(call install,.)
	@touch $@

.venv/.mutants: pyproject.toml client/pyproject.toml
	$(call install,.[mutants])
	@touch .venv/.demo .venv/.installed $@

demo: .venv/.demo
	@$(BIN)/skin demo $(ARGS)

figures: setup
	@$(BIN)/python -m docs.figures $(ARGS)

docs: setup
	@$(BIN)/python -m docs.reference
	@$(BIN)/python -m docs.faults
	@$(BIN)/python -m docs.layout_keys
	@$(BIN)/python -m docs.site_pages build/site
	@$(BIN)/zensical build --strict --config-file build/site/mkdocs.yml
	@echo "build/site/site/index.html"

# On several cores. One worker compiles the kernels, then runs whole chains (tests/conftest.py); others go by file.
BY_FILE := --dist loadfile --no-loadscope-reorder --max-worker-restart 0
# The cores have enough to do without threads of BLAS, and a hundred services start from the Python that one has compiled.
ON_CORES := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 PYTHONDONTWRITEBYTECODE= $(BIN)/pytest -q $(BY_FILE)

# One worker more than cores: whole chains wait more than they compute.
test: check
	$(ON_CORES) --numprocesses $$(($$(nproc) + 1))

test-vcan: setup
	tests/vcan/run

test-mcu: setup
	tests/mcu/run

test-containers: setup wheels
	tests/containers/run

# One file for every platform and Python; hatchling builds our own packages in the image.
lock: setup
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check "uv>=0.9,<1"
	printf '%s\n' ./client '.[metrics]' 'hatchling>=1.27,<2' | $(BIN)/uv pip compile --quiet --upgrade --universal --python-version $(OLDEST) \
		--no-emit-package canskin --no-emit-package canskin-client --no-annotate --no-header --output-file requirements.lock -

wheels: wheels/.complete

wheels/.complete: requirements.lock | setup
	@rm -rf wheels
	@$(BIN)/python -m pip download --quiet --quiet --disable-pip-version-check --only-binary :all: --python-version $(OLDEST) $(ARGS) \
		--dest wheels --requirement requirements.lock
	@touch $@

mutants: .venv/.mutants
	@$(BIN)/python tests/mutants/find.py $(ARGS)

# The quick loop while working: no heavy tests and no slow ones; it names the longest: those that compile, or have become heavy.
loop: setup
	$(ON_CORES) --numprocesses auto -m "not heavy and not slow" --durations 5

check: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
