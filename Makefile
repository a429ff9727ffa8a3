# `make train`, `make test` and `make docs` set everything up themselves, in .venv, on a machine with Python 3.11 or later.
# ARGS goes to the command: make train ARGS="--seed 3 --set train.iterations=10"
PYTHON ?= python3
VENV ?= .venv
OUT ?= runs/first
ARGS ?=

BIN = $(VENV)/bin
NETWORKS = $(patsubst %,networks/%.net.xml,arterial highway2 highway3 highway4 highway5 highway6 lane_drop onramp ring5)

.PHONY: setup train test lint docs reference page-tests networks clean

setup: $(VENV)/installed

train: setup
	$(BIN)/rail-sumo train --out $(OUT) $(ARGS)

# A test process on every core, since libsumo holds one simulation in a process. In one process: make test ARGS="-n 0"
test: setup
	$(BIN)/pytest -n auto --dist loadgroup $(ARGS)

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# The site, in build/docs. A broken link, a name that is not there and an example that fails are errors.
docs: $(VENV)/sphinx
	$(BIN)/python -m sphinx --builder html --fail-on-warning --keep-going --fresh-env --quiet $(ARGS) docs build/docs
	@echo "the site is in build/docs/index.html"

# The pages of docs/reference that are made from the code. A test holds them against it.
reference: setup
	$(BIN)/python docs/_site/reference.py

# The replay page: its scripts are linted, and it is opened in a browser. Needs Node.js 20 or later, npm and Chromium.
page-tests: setup tests/page/node_modules/installed
	cd tests/page && npm run --silent lint
	$(BIN)/python tests/films.py build/pages
	cd tests/page && PAGES=$(abspath build/pages) npm test --silent

tests/page/node_modules/installed: tests/page/package.json tests/page/package-lock.json
	cd tests/page && npm ci --silent --no-audit --no-fund
	touch $@

# Rebuild the committed networks from their sources. The header that netconvert writes (a date, absolute paths) is cut.
networks: $(VENV)/netconvert
	$(PYTHON) networks/ring5/circle.py
	$(PYTHON) networks/bends.py
	$(MAKE) --always-make $(NETWORKS)

networks/%.net.xml:
	cd networks/$* && $(abspath $(BIN))/netconvert -c $*.netccfg
	sed -i.header -e '/^<!--/,/-->$$/d' -e '/^$$/d' $@ && rm $@.header

clean:
	rm -rf $(VENV)

$(VENV)/installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet -c constraints.txt --upgrade pip
	$(BIN)/python -m pip install --quiet -c constraints.txt --group dev -e .
	touch $@

$(VENV)/sphinx: $(VENV)/installed
	$(BIN)/python -m pip install --quiet -c constraints.txt -e ".[docs]"
	touch $@

$(VENV)/netconvert: $(VENV)/installed
	$(BIN)/python -m pip install --quiet -c constraints.txt -e ".[networks]"
	touch $@
