# Two commands matter: `make demo` and `make test`. Both set up .venv by themselves; `make help` lists the rest.
# Another interpreter: `make demo PYTHON=/path/to/python3.12`. Another place for the environment: VENV=...

SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help

VENV ?= .venv
PYTHON ?=
RUN := $(VENV)/bin/python
# Python compiles what is imported when it is; compiling all of a dozen packages at once takes longer than installing them.
PIP := $(RUN) -m pip install --quiet --disable-pip-version-check --no-compile --constraint constraints.txt
DEMO_OUT ?= results/demo
# Processes that run tests side by side; tests of one file, or of one formula of an effect, stay together, and
# tests/conftest.py says which files come first.
JOBS ?= 2
TESTS = $(RUN) -m pytest --numprocesses $(JOBS) --dist loadfile --no-loadscope-reorder

export PYTHONHASHSEED := 0
export OMP_NUM_THREADS ?= 1
export MPLBACKEND := Agg
export NO_MKDOCS_2_WARNING := 1
# Where Python may not keep what it has read, each process of the tests reads two hundred files of them anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help demo test slow tests lint types notebooks docs prove ranges format clean

help: ## this list
	@grep -hE '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z]+):.*## /  make \1\t/' | expand -t 20

# The first interpreter of 3.11 or newer that can make virtual environments.
$(RUN):
	@python=""; \
	for candidate in $(if $(PYTHON),"$(PYTHON)",python3.13 python3.12 python3.11 python3); do \
	    if command -v "$$candidate" >/dev/null \
	        && "$$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null \
	        && "$$candidate" -c 'import ensurepip, venv' 2>/dev/null; then python="$$candidate"; break; fi; \
	done; \
	if [ -z "$$python" ]; then \
	    echo "bayes_damper needs Python 3.11 or newer with the venv and ensurepip modules; none was found$(if $(PYTHON), at '$(PYTHON)',)." >&2; \
	    echo "Install one (Debian, Ubuntu: apt install python3 python3-venv) or say where it is: make demo PYTHON=/path/to/python3" >&2; \
	    exit 2; \
	fi; \
	echo "Setting up $(VENV) with $$("$$python" --version)"; \
	"$$python" -m venv "$(VENV)"

$(VENV)/.core: pyproject.toml constraints.txt | $(RUN)
	@echo "Installing bayes_damper and what it needs (a minute or two the first time)"
	@$(PIP) --editable .
	@touch $@

$(VENV)/.dev: $(VENV)/.core
	@echo "Installing the development tools"
	@$(PIP) --editable '.[dev]'
	@touch $@

$(VENV)/.docs: $(VENV)/.core
	@$(PIP) --editable '.[docs]'
	@touch $@

demo: $(VENV)/.core ## fit the four cases of the thesis: table, figures, files
	@$(VENV)/bin/bayes-damper demo --out $(DEMO_OUT)

test: $(VENV)/.dev ## the quick tests
	@$(TESTS) -m "not slow and not prove"

slow: $(VENV)/.dev ## the tests that take longer
	@$(TESTS) -m "slow and not prove"

tests: $(VENV)/.dev ## the quick and the slow ones in one run, which share what files prepare
	@$(TESTS) -m "not prove"

lint: $(VENV)/.dev ## ruff: rules and format
	@$(RUN) -m ruff check .
	@$(RUN) -m ruff format --check .

format: $(VENV)/.dev ## let ruff repair what it can
	@$(RUN) -m ruff check --fix .
	@$(RUN) -m ruff format .

types: $(VENV)/.dev ## mypy
	@$(RUN) -m mypy

notebooks: $(VENV)/.dev ## run every notebook
	@notebooks=$$(find notebooks -name '*.ipynb' -not -path '*/.*' | sort); \
	if [ -z "$$notebooks" ]; then echo "There are no notebooks in notebooks/"; \
	else $(RUN) -m pytest --numprocesses $(JOBS) --dist worksteal --nbmake --nbmake-timeout=600 \
	    --import-mode=prepend -W default $$notebooks; fi

docs: $(VENV)/.docs ## build the documentation, warnings are errors
	@$(RUN) -m mkdocs build --strict --quiet
	@echo "The pages are in site/; open site/index.html in a browser"

prove: $(VENV)/.dev ## the long statistical proofs; goes on where it stopped; pages in docs/proof
	@$(TESTS) -m prove

# In an environment of its own, without the constraints: do today's newest versions within the ranges install and import?
ranges: $(RUN) ## install by ranges alone, in a fresh environment, and import everything
	@folder=$$(mktemp -d); trap 'rm -rf "$$folder"' EXIT; \
	$(RUN) -c 'import sys, venv; venv.create(sys.argv[1], with_pip=True)' "$$folder/venv"; \
	"$$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check --report "$$folder/report.json" '.[check]'; \
	cd "$$folder"; \
	venv/bin/python -c 'import importlib, pkgutil, bayes_damper as b; \
	names = [m.name for m in pkgutil.walk_packages(b.__path__, "bayes_damper.")]; \
	[importlib.import_module(n) for n in names]; print(len(names), "modules import with the newest versions that the ranges allow")'; \
	venv/bin/bayes-damper --help > /dev/null; \
	venv/bin/python -m pip --disable-pip-version-check check

clean: ## remove what building and testing left behind, but no results
	@rm -rf build dist site .pytest_cache .mypy_cache .ruff_cache .hypothesis
