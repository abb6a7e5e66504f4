# The two commands of the README, and what the developers run. Everything happens in .venv.
PYTHON ?= python3
BIN := .venv/bin

.PHONY: demo test fuzz kills lint bench suite packages docs models clean

demo: .venv/installed
	$(BIN)/cmbot plan triangle --output out/triangle --force

# Neighbours share what was planned for them: they stay together until a worker has nothing left to do.
test: .venv/tested
	$(BIN)/pytest -n auto --dist worksteal

# Takes hours.
fuzz: .venv/tested
	$(BIN)/python tools/fuzz.py --count 100000

# Kills at every step on the file system, the second time by strace in whole processes: that takes an hour.
kills: .venv/tested
	CMBOT_KILLS_APART=1 $(BIN)/pytest -n auto tests/cli -k a_kill_leaves
	$(BIN)/python tools/kill_calls.py

lint: .venv/tested
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python tools/build_models.py --check
	$(BIN)/python tools/build_schema.py --check
	$(BIN)/python tools/structure.py

bench: .venv/benched
	$(BIN)/python benchmarks/run.py

# Takes some minutes, for the image or its steps.
packages: .venv/packaged
	$(BIN)/python tools/try_packages.py

# Takes hours; what has not changed since the last run is not run again.
suite: .venv/tested
	$(BIN)/python benchmarks/run_suite.py

docs: .venv/documented
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

models: .venv/installed
	$(BIN)/python tools/build_models.py
	$(BIN)/python tools/build_schema.py

clean:
	rm -rf .venv out dist site

.venv/bin/python:
	$(PYTHON) -m venv .venv

.venv/installed: pyproject.toml | .venv/bin/python
	$(BIN)/python -m pip install --quiet --editable '.[fast]'
	touch $@

.venv/benched: pyproject.toml | .venv/bin/python
	$(BIN)/python -m pip install --quiet --editable '.[bench]'
	touch $@

.venv/documented: pyproject.toml | .venv/bin/python
	$(BIN)/python -m pip install --quiet --editable '.[docs]'
	touch $@

.venv/packaged: | .venv/bin/python
	$(BIN)/python -m pip install --quiet py-rattler-build
	touch $@

.venv/tested: pyproject.toml | .venv/bin/python
	$(BIN)/python -m pip install --quiet --editable '.[test]'
	touch .venv/installed .venv/documented $@
