# palpate: `make demo` shows what it does, `make test` that it works. Both install into .venv first.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
OUT ?= out
# no bytecode for a gigabyte of packages: Python writes it for those that are imported
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet
SOURCES := scenes vision touch fusion tests

.DEFAULT_GOAL := help
.PHONY: help install install-test demo test test-slow lint bench clean

help:
	@echo "make install    .venv with the command .venv/bin/palpate; quick when nothing changed"
	@echo "make demo       a grasp that hides most of an object: ICP, vision, touch and both; $(OUT)/demo/report.html"
	@echo "make test       the tests; make test-slow those that take minutes"
	@echo "make lint       ruff and mypy"
	@echo "make bench      the benchmarks"

install: $(VENV)/installed

install-test: $(VENV)/installed-test

# Stamps hold the time of the last install that went well; pyproject.toml says what is installed.
$(VENV)/installed: pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' \
		|| { echo "palpate needs Python 3.10 or later, got $$($(PYTHON) --version)" >&2; exit 2; }
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV) \
		|| { rm -rf $(VENV); echo "no virtual environment: install the system package python3-venv" >&2; exit 2; }
	@echo "installing palpate into $(VENV)"
	@$(PIP) install --no-compile --editable .
	@touch $@

$(VENV)/installed-test: $(VENV)/installed
	@echo "installing what the tests need"
	@$(PIP) install --no-compile --editable '.[test]'
	@touch $@

demo: install
	@$(BIN)/palpate demo --out $(OUT)/demo

test: install-test
	@$(BIN)/python -m pytest -m "not slow"

test-slow: install-test
	@$(BIN)/python -m pytest -m slow

lint: install-test
	@$(BIN)/ruff check $(SOURCES)
	@$(BIN)/ruff format --check $(SOURCES)
	@$(BIN)/mypy

bench: install
	@$(BIN)/palpate bench all

clean:
	rm -rf $(VENV) $(OUT) build dist *.egg-info
