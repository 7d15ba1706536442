# `make demo` and `make test` need nothing but Python 3.11 or later.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
OUT ?= out
# without JIT these take long and show nothing about drive/ that the others do not
NOT_THE_DRIVE := cli docs engine evaluate learn pictures plants masters tasks view policies \
	canopen/test_interop.py canopen/test_bus.py

.PHONY: demo test tests docs lint types stub fix bench coverage slow clean

demo: $(VENV)/run
	$(BIN)/servogym demo --out $(OUT)

test: $(VENV)/test # lint beside the tests: mypy knows one core only
	$(MAKE) --no-print-directory -j2 lint tests

tests: $(VENV)/test # with byte code kept: each worker and each command would compile it again
	env -u PYTHONDONTWRITEBYTECODE MUJOCO_GL=$${MUJOCO_GL:-egl} \
		$(BIN)/python -m pytest -n auto --dist loadgroup --no-loadscope-reorder

lint: $(VENV)/test
	$(BIN)/ruff check .
	$(MAKE) --no-print-directory types
	$(BIN)/lint-imports

types: $(VENV)/test # under the names of the installed package, which mypy remembers by file
	rm -rf $(VENV)/typed
	mkdir $(VENV)/typed
	ln -s ../.. $(VENV)/typed/servogym
	MYPYPATH=$(VENV)/typed $(BIN)/mypy

stub: $(VENV)/test # the record as types, after a change of its fields
	$(BIN)/python tests/kernel/record_stub.py

fix: $(VENV)/test # what ruff can mend by itself
	$(BIN)/ruff check --fix .

bench: $(VENV)/run
	$(BIN)/servogym bench

docs: $(VENV)/test # with the pictures of the lessons
	$(BIN)/python -m sphinx -W -b html docs $(OUT)/docs

coverage: $(VENV)/test
	NUMBA_DISABLE_JIT=1 $(BIN)/python -m pytest -n auto --cov --cov-report=term-missing:skip-covered $(addprefix --ignore=tests/,$(NOT_THE_DRIVE))

SHARE ?= 1/1
WHERE ?= tests
slow: $(VENV)/test # SHARE=3/40: every 40th of them, from the third on; WHERE="FILES": those
	$(BIN)/python -m pytest -m slow --share $(SHARE) $(WHERE)

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
