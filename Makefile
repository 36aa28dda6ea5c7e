# The words people and CI use. Every word makes the virtual environment first, so each works as the first command.
PYTHON ?= python3
BIN := .venv/bin

# On a terminal pip shows each package and a bar; elsewhere (CI) only what goes wrong.
PIP_SAYS := $(shell test -t 2 || echo --quiet)

.DEFAULT_GOAL := help
.PHONY: help demo test check format bench docs proto clean

help: ## list the words
	@sed -n 's/^\([a-z]*\):.*## /  make \1\t/p' Makefile

.venv/installed: pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "make: $(PYTHON) is older than Python 3.11; name a newer one: make PYTHON=python3.12"; exit 2; }
	@test -x $(BIN)/python || { echo "making .venv ..."; $(PYTHON) -m venv .venv || { echo "make: $(PYTHON) has no venv module (Debian: apt install python3-venv)"; exit 2; }; }
	@echo "installing asterism and what it needs into .venv: about 1 GB to download the first time, most of it the viewer;"
	@echo "a few minutes on a fast line ..."
	@# Until 0.1 the distribution was called asterism; in this environment nothing else is.
	@$(BIN)/python -m pip uninstall --quiet --yes asterism 2>/dev/null || true
	@$(BIN)/python -m pip install $(PIP_SAYS) --disable-pip-version-check --editable '.[all,dev]'
	@echo "installed."
	@touch $@

demo: .venv/installed ## five simulated robots: localized, published, recorded, watched
	$(BIN)/asterism demo

test: .venv/installed ## the test suite
	@# A file's tests stay together: they share what their fixtures made.
	$(BIN)/python -m pytest -q --numprocesses=2 --dist=loadfile

check: .venv/installed ## formatting, lint, types
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: .venv/installed ## format the code and sort the imports
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

bench: .venv/installed ## speed and accuracy beside other programs, centres beside the Cramer-Rao bound; plots in bench-out/
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[bench]'
	$(BIN)/python -m tests.measure.bench bench-out

docs: .venv/installed ## the documentation as a website, in site/
	@NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet
	@echo "open site/index.html"

proto: .venv/installed ## compile protocol/asterism.proto
	@# In an environment of its own: this compiler's code runs with every protobuf from 5.29 on, itself it wants an old one.
	$(PYTHON) -m venv build/protoc && build/protoc/bin/python -m pip install --quiet grpcio-tools==1.71.2
	build/protoc/bin/python -m grpc_tools.protoc --proto_path=protocol --python_out=protocol --pyi_out=protocol asterism.proto

clean: ## remove the virtual environment and caches
	rm -rf .venv build site *.egg-info .pytest_cache .mypy_cache .ruff_cache
