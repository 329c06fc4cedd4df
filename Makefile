# SPDX-License-Identifier: MIT
# From a fresh clone: `make demo` or `make test`, nothing else. Each installs what is missing.

PYTHON ?= python3
BIN := .venv/bin
INSTALLED := .venv/.installed
DEMO ?= demo
# Versions to install: constraints-lowest.txt tests the lowest ones.
CONSTRAINTS ?= constraints.txt
# Processes that test side by side; each takes half a gigabyte.
WORKERS ?= 2

.PHONY: help install demo test test-slow lint format docs wheel workflows clean

help:
	@echo "make demo       a small synthetic drive: predict, evaluate, export, look"
	@echo "make test       all tests but the slow ones"
	@echo "make test-slow  the slow tests"
	@echo "make lint       style, types, spelling and words"
	@echo "make docs       the documentation, into site/"
	@echo "make wheel      the distributions, into dist/, and a trial of them"
	@echo "make workflows  check the workflows of continuous integration"
	@echo "make clean      remove what the others made"

install: $(INSTALLED)

$(INSTALLED): pyproject.toml $(CONSTRAINTS)
	@tools/system-libraries
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --requirement $(CONSTRAINTS)
	$(BIN)/python -m pip install --quiet --constraint $(CONSTRAINTS) --editable '.[dev]'
	@touch $@

demo: $(INSTALLED)
	$(BIN)/salsanext demo $(DEMO)

# Tests start many processes, which load compiled modules faster than they compile them.
test: $(INSTALLED)
	@tools/system-libraries chromium
	PYTHONDONTWRITEBYTECODE= OMP_NUM_THREADS=1 $(BIN)/python -m pytest --numprocesses $(WORKERS) --dist worksteal

test-slow: $(INSTALLED)
	PYTHONDONTWRITEBYTECODE= OMP_NUM_THREADS=1 $(BIN)/python -m pytest --numprocesses $(WORKERS) --dist worksteal \
		-m 'slow or hypothesis' --hypothesis-profile=many

lint: $(INSTALLED)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/oxlint --deny-warnings
	$(BIN)/mypy
	git ls-files '*.md' '*.py' '*.toml' | xargs $(BIN)/codespell
	$(BIN)/python tools/words.py

format: $(INSTALLED)
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

docs: $(INSTALLED)
	$(BIN)/python -m pip install --quiet --constraint $(CONSTRAINTS) --editable '.[docs]'
	$(BIN)/python docs/reference.py
	$(BIN)/salsanext demo $(DEMO)
	install -D -m 644 $(DEMO)/out/report.html docs/example/report.html
	$(BIN)/mkdocs build --strict

wheel: $(INSTALLED)
	rm -rf dist
	$(BIN)/python -m build --quiet
	$(BIN)/python -m build --quiet --outdir dist examples/paper_networks
	$(BIN)/python -m twine check --strict dist/*
	SALSANEXT_WHEELS=dist $(BIN)/python -m pytest -m slow tests/test_wheel.py

workflows: $(INSTALLED)
	$(BIN)/python -m pip install --quiet check-jsonschema zizmor
	$(BIN)/check-jsonschema --builtin-schema vendor.github-workflows .github/workflows/*.yml
	$(BIN)/check-jsonschema --builtin-schema vendor.github-issue-forms $(filter-out %/config.yml,$(wildcard .github/ISSUE_TEMPLATE/*.yml))
	$(BIN)/check-jsonschema --builtin-schema vendor.dependabot .github/dependabot.yml
	$(BIN)/zizmor --offline .github

clean:
	find . -name __pycache__ -not -path './.venv/*' -prune -exec rm -rf {} +
	rm -rf .venv dist site demo docs/example .pytest_cache .mypy_cache .ruff_cache .hypothesis
