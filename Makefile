# Two commands: `make demo` runs the main job on the simulated arm, `make test` the tests. Both set up .venv first.
PYTHON ?= python3
BIN := .venv/bin

.PHONY: venv demo test test-noble lint clean

venv: .venv/.ready

# --use-pep517: an older pip would follow setup.cfg, as colcon must, and put the commands where no shell looks.
.venv/.ready: setup.py constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	  || { echo "Python 3.11 or newer is needed: make PYTHON=python3.12 $(MAKECMDGOALS)"; exit 1; }
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --use-pep517 -c constraints.txt -e '.[ros,test]'
	@$(BIN)/spacearm --version
	@touch $@

demo: venv
	$(BIN)/spacearm demo --out demo_result

# Those that keep time wait more than they compute: one a core, each with ROS domains of its own (test/domains.py, which
# has enough for 8). Then, one after another, those that want all cores.
test: venv lint
	$(BIN)/python -m pytest -m "not live" -n auto --dist worksteal --durations=20
	$(BIN)/python -m pytest -m "live and not alone" -n auto --maxprocesses 8 --dist loadfile --durations=20
	$(BIN)/python -m pytest -m alone --durations=20

# The tests that keep no time, with Python 3.12 and the versions of Ubuntu 24.04: what a ROS 2 Jazzy machine has.
# Not those marked `long`, which take nearly half as long as all the others.
test-noble: .venv-noble/.ready
	.venv-noble/bin/python -m pytest -m "not live and not long" -n auto --dist worksteal

.venv-noble/.ready: setup.py constraints-noble.txt .ci/python3.12
	python=$$(.ci/python3.12) && "$$python" -m venv .venv-noble
	.venv-noble/bin/python -m pip install --quiet --disable-pip-version-check --no-deps -r constraints-noble.txt
	.venv-noble/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --use-pep517 -e .
	@touch $@

lint: venv
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy

clean:
	rm -rf .venv .venv-noble build install log demo_result *.egg-info
