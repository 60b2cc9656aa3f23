# `make demo` and `make test` do everything on a fresh machine; both build the virtual environment they need.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
JOBS ?= 2
PYTEST = $(BIN)/pytest -n $(JOBS) --dist worksteal
# What is compiled once is kept for the next run and for every program that a test starts, whatever a container says.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo demo-all docs test tests types test-rl test-panel test-realtime test-socketcan test-socketcan-timing test-slow test-long \
        test-lowest test-all mutants bench models install tutorials reference pictures clean

demo: $(READY)
	$(BIN)/allegro-twin run scenarios/demo --side both --out out

demo-all: $(READY)
	$(BIN)/allegro-twin run scenarios/demo scenarios/more --side both --out out || test $$? -eq 5

# All that the base and the extra dev can run, on a computer that may be busy with other work. The tests wait for time now and
# then: the types beside them.
test: $(READY)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(MAKE) --no-print-directory --jobs=2 tests types

tests: $(READY)
	$(PYTEST)

types: $(READY)
	$(BIN)/mypy

# Learning: PyTorch and its learners, which are gigabytes.
RL := $(VENV)/.rl
test-rl: $(RL)
	$(PYTEST) -m 'not long and not realtime' --whole rl tests/learning/training tests/learning/policy tests/learning/environments tests/pick tests/test_arrays.py tests/test_examples.py

$(RL): $(READY)
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[rl,rsl]'
	@touch $@

# The panel in a browser: apt-get install chromium.
PANEL := $(VENV)/.panel
test-panel: $(PANEL)
	$(PYTEST) -m 'not long and not realtime' --whole panel tests/surfaces/panel

$(PANEL): $(READY)
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[panel]' playwright
	@touch $@

# Programs that talk to each other while time passes: alone on a computer that has time, one after the other.
test-realtime: $(READY) test-socketcan
	$(BIN)/pytest -m 'realtime and not long'

test-socketcan: $(READY)
	$(BIN)/python -m tests.socketcan.guest --color=no

test-socketcan-timing: $(READY)
	$(BIN)/python -m tests.socketcan.emulated --color=no

# What takes seconds, or a kind of its own of what `make test` has one of.
test-slow: $(READY)
	$(PYTEST) -m 'slow and not long and not realtime'

test-long: $(READY)
	$(PYTEST) -m 'long and not realtime'
	$(BIN)/pytest -m 'long and realtime'

test-all: test test-slow test-realtime test-rl test-panel test-long test-socketcan-timing

# Mutation testing, hours: small errors that no test sees. A run that is cut off continues. docs/results/tests.md has the
# last result.
MUTANTS ?= --count 200 --seed 1 --budget 20 --bar 0.9
mutants: $(RL) $(PANEL)
	-$(BIN)/python -m tests.mutants --map
	$(BIN)/python -m tests.mutants $(MUTANTS)

# Every lower bound of pyproject.toml, as it stands there, but of the extras that bring PyTorch or Ray, which are gigabytes.
# A newer click's warnings about an older typer are not ours.
LOWEST := .venv-lowest
CORE := tests/test_architecture.py tests/test_safety.py tests/test_spec.py tests/test_types.py tests/test_loop.py \
        tests/viewing tests/contract tests/control tests/hands/description tests/hands/library tests/recording tests/sim \
        tests/surfaces/cli/test_wrong_inputs.py tests/surfaces/cli/test_doctor.py tests/learning/policy tests/surfaces/panel tests/surfaces/ros tests/surfaces/teleop
test-lowest: $(LOWEST)/.ready
	$(LOWEST)/bin/pytest -o filterwarnings=default -p no:cacheprovider $(CORE)
	$(LOWEST)/bin/allegro-twin run lemon
	NO_MKDOCS_2_WARNING=1 $(LOWEST)/bin/python -m mkdocs build --quiet --site-dir out/site-lowest

$(LOWEST)/.ready: pyproject.toml
	$(PYTHON) -m venv $(LOWEST)
	$(LOWEST)/bin/pip install --quiet uv
	$(LOWEST)/bin/uv pip install --quiet --python $(LOWEST)/bin/python --resolution lowest-direct \
	  --only-binary :all: --no-binary allegro-twin --editable '.[dev,docs,menagerie,panel,webcam]'
	@touch $@

# The site, in out/site, tested: python3 -m http.server -d out/site (without a server its search does not work).
DOCS := $(VENV)/.docs
docs: $(DOCS)
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --quiet
	$(BIN)/pytest tests/test_site.py

$(DOCS): $(READY)
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[docs]'
	@touch $@

# Runs the tutorials anew and keeps what they show: minutes.
tutorials: $(DOCS) $(RL)
	$(BIN)/python docs/site/execute.py

# The generated pages of the reference: commands.md, configs.md and api/.
reference: $(READY)
	$(BIN)/python docs/site/reference.py

# The pictures of the docs, by the commands that the docs name: apt-get install chromium for those of the panel.
pictures: $(PANEL)
	$(BIN)/python docs/site/pictures.py

bench: $(READY)
	$(BIN)/python -m benchmarks

models: $(READY)
	$(BIN)/python -m allegro_twin.hands.generate

install: $(READY)

$(READY): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "allegro_twin needs Python 3.11 or newer; choose one with: make PYTHON=python3.12 $(MAKECMDGOALS)"; exit 1; }
	$(PYTHON) -m venv $(VENV) || { echo "Debian and Ubuntu: apt-get install python3-venv"; exit 1; }
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev]'
	@touch $@

clean:
	rm -rf $(VENV) $(LOWEST) out
