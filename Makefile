# `make demo` and `make test` need nothing but Python 3.11 or later.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
OUT ?= out
# without JIT these take long and show nothing about drive/ that the others do not
NOT_THE_DRIVE := test_cli.py test_readme.py test_scope.py test_homing_gallery.py test_machine.py \
	test_linear_axis.py test_positioning.py test_vector_env.py test_gantry.py test_bridge.py \
	test_coordination.py test_compliance.py test_sb3.py test_train.py test_examples.py \
	canopen/test_interop.py canopen/test_bus.py

.PHONY: demo test lint types format bench coverage slow clean

demo: $(VENV)/run
	$(BIN)/servogym demo --out $(OUT)

test: lint
	MUJOCO_GL=$${MUJOCO_GL:-egl} $(BIN)/python -m pytest

lint: $(VENV)/test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(MAKE) --no-print-directory types
	$(BIN)/lint-imports

types: $(VENV)/test # the package as it is installed
	rm -rf $(VENV)/typed build
	$(BIN)/python -m pip install --quiet --no-deps --target $(VENV)/typed .
	MYPYPATH=$(VENV)/typed $(BIN)/mypy

format: $(VENV)/test
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

bench: $(VENV)/run
	$(BIN)/servogym bench

coverage: $(VENV)/test
	NUMBA_DISABLE_JIT=1 $(BIN)/python -m pytest -n auto --cov --cov-report=term-missing:skip-covered $(addprefix --ignore=tests/,$(NOT_THE_DRIVE))

slow: $(VENV)/test
	$(BIN)/python -m pytest -m slow

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip

$(VENV)/run: pyproject.toml | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --quiet --editable .
	touch $@

$(VENV)/test: pyproject.toml | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --quiet --editable ".[dev,train]"
	touch $@ $(VENV)/run

clean:
	rm -rf $(VENV) $(OUT) build dist *.egg-info .pytest_cache .ruff_cache .mypy_cache .hypothesis
