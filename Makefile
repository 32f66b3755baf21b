PYTHON ?= python3
BIN := .venv/bin

.PHONY: demo test check clean

demo: .venv/.ready ## launch the street crossing, record it, draw it
	$(BIN)/footfall demo

test: .venv/.ready ## all tests
	$(BIN)/python -m pytest

check: .venv/.ready ## everything CI and reviewers look at
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/pyright
	$(BIN)/lint-imports
	$(BIN)/python -m pytest

.venv/.ready: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[sim,learn,view,dev]'
	touch $@

clean:
	rm -rf .venv build dist *.egg-info
