# palpate: `make demo` shows what it does, `make test` that it works. Both install into .venv first.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
OUT ?= out
# no bytecode for a gigabyte of packages, only for those that a run imports: two seconds less at every start
IMPORTED := numpy scipy numba llvmlite trimesh open3d dash flask werkzeug plotly ipywidgets nbformat cv2 rich
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet
ROOMS := scenes vision touch fusion
SOURCES := $(ROOMS) tests
KERNELS := $(shell grep -rl --include='*.py' 'import.*njit\|import numba' $(ROOMS))

.DEFAULT_GOAL := help
.PHONY: help install install-test demo test test-slow lint bench docs gallery clean

help:
	@echo "make install    .venv with the command .venv/bin/palpate; quick when nothing changed"
	@echo "make demo       a grasp that hides most of an object: ICP, vision, touch and both; $(OUT)/demo/report.html"
	@echo "make test       the tests; make test-slow those that take minutes"
	@echo "make lint       ruff and mypy"
	@echo "make bench      the benchmarks"
	@echo "make docs       the pages as a site in $(OUT)/docs, links checked"
	@echo "make gallery    the gallery's scenes and pictures anew"

install: $(VENV)/installed $(VENV)/kernels

install-test: $(VENV)/installed-test $(VENV)/kernels

# Numba compiles a kernel anew when its own file changes, not when another's does that it has compiled in.
$(VENV)/kernels: $(KERNELS) | $(VENV)/installed
	@find $(ROOMS) -name '*.nb[ic]' -delete
	@touch $@

# Stamps hold the time of the last install that went well; pyproject.toml says what is installed.
$(VENV)/installed: pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' \
		|| { echo "palpate needs Python 3.10 or later, got $$($(PYTHON) --version)" >&2; exit 2; }
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV) \
		|| { rm -rf $(VENV); echo "no virtual environment: install the system package python3-venv" >&2; exit 2; }
	@echo "installing palpate into $(VENV)"
	@$(PIP) install --no-compile --editable .
	@cd $(VENV)/lib/python3*/site-packages && ../../../bin/python -m compileall -q -j 0 $(IMPORTED) >/dev/null 2>&1 || true
	@$(BIN)/python -m compileall -q -j 0 $(ROOMS) >/dev/null 2>&1 || true
	@touch $@

$(VENV)/installed-test: $(VENV)/installed
	@echo "installing what the tests need"
	@$(PIP) install --no-compile --editable '.[test]'
	@touch $@

demo: install
	@$(BIN)/palpate demo --out $(OUT)/demo

test: install-test
	@$(BIN)/python -m pytest -m "not slow" -n auto

test-slow: install-test
	@$(PIP) install --no-compile --editable '.[docs]'
	@$(BIN)/python -m pytest -m slow

lint: install-test
	@$(BIN)/ruff check $(SOURCES)
	@$(BIN)/ruff format --check $(SOURCES)
	@$(BIN)/mypy

bench: install
	@$(BIN)/palpate bench all

docs: install
	@$(PIP) install --no-compile --editable '.[docs]'
	@$(BIN)/python docs/build_api.py
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict --site-dir $(OUT)/docs

gallery: install
	@$(BIN)/python docs/build_gallery.py

clean:
	rm -rf $(VENV) $(OUT) build dist *.egg-info
	find $(ROOMS) -name '*.nb[ic]' -delete
