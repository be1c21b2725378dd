# SPDX-License-Identifier: Apache-2.0
# PYTHON=python3.12 chooses the Python; PYTEST_ARGS="-k name" goes to pytest, WORKERS=1 runs one test at a time, and
# ALL=1 runs the slow tests too, as .ci/run does.

CORES = $(shell nproc)
# Most tests of flights wait half of their time. A worker needs up to 1 GB of memory.
WORKERS = $(shell echo $$(($(CORES) < 8 ? 2 * $(CORES) : 16)))

.PHONY: setup demo test test-packages test-kilted other-machine simulate torture fuzz lint docs-packages docs bench figures clean help

setup:  ## build .venv and the workspace where missing or stale (other targets do this where needed)
	@tools/setup

demo: setup  ## fly 13 geese over ROS 2 to their steady state, record, measure and report on them
	@./flock fly --output runs/demo --force
	@./flock picture runs/demo
	@./flock report runs/demo
	@echo
	@echo "The bag is runs/demo; a picture of the formation and a report are in it: open runs/demo/report.html"
	@echo "in a browser. The same flight without ROS, equal bit for bit:"
	@echo "  ./flock reference --output runs/reference && ./flock compare runs/demo runs/reference"

test: setup  ## run the tests; ALL=1: the slow ones too
	@./flock python -m pytest --numprocesses $(WORKERS) --dist loadfile --no-loadscope-reorder \
		$(if $(ALL),,-m "not slow") $(PYTEST_ARGS)

test-packages: setup  ## run the short tests inside the packages, as `colcon test` does
	@./flock python -m colcon test --base-paths src --test-result-base build/test-results
	@./flock python -m colcon test-result --test-result-base build/test-results --verbose

test-kilted:  ## fly with ROS 2 Kilted, which has Fast DDS 3, from a copy of this tree in build/kilted
	@tools/test-kilted $(PYTEST_ARGS)

other-machine: setup  ## fly the golden flights on emulated processors: 64-bit Arm, and x86 without FMA (needs Debian and qemu-user)
	@tools/other-machine

simulate: setup  ## fly a million steps of simulated birds with all faults, and check each state (five minutes)
	@./flock python tests/simulate.py --jobs $(CORES) $(SIMULATE_ARGS)

torture: simulate  ## kill, interrupt and forge the messages of flights, attack bags, and let each I/O call fail (some hours)
	@cd tests && ../flock python torture.py $(TORTURE_ARGS)
	@FLOCK_TORTURE=1 ./flock python -m pytest -q tests/unit/protocol/test_stage_fuzz.py tests/unit/recording/test_torture.py
	@FLOCK_RANDOM_FLIGHTS=200 FLOCK_INTERRUPTS=200 FLOCK_FORGERIES=216 FLOCK_VARIED_FLIGHTS=200 \
		./flock python -m pytest -q tests/e2e/test_random_flights.py tests/e2e/test_interrupts.py \
		tests/e2e/test_offline_tools.py tests/ros/test_forged.py
	@FLOCK_IO_FAULTS=1000 ./flock python -m pytest -q -n $(CORES) -o faulthandler_timeout=36000 tests/e2e/test_failing_io.py

fuzz: setup  ## read 100,000 random files of users of each kind, and send 1,000,000 messages to each node (some hours)
	@FLOCK_FUZZ=100000 ./flock python -m pytest -q -n $(CORES) -o faulthandler_timeout=3600 tests/unit/outside/test_fuzz.py \
		tests/unit/bag/test_random_bags.py
	@FLOCK_FUZZ=1000000 ./flock python -m pytest -q -n $(CORES) -o faulthandler_timeout=36000 tests/ros/test_message_fuzz.py

lint: setup  ## check style and types
	@./flock python -m ruff check
	@./flock python -m ruff format --check
	@./flock python -m mypy
	@./flock python -c "from importlinter.cli import lint_imports_command; lint_imports_command()" --no-cache

docs-packages: setup
	@./flock python -m pip install --quiet --disable-pip-version-check --no-deps -r requirements/docs.txt

docs: docs-packages  ## generate docs/tools.md and docs/messages.md, and build the site in build/site
	@./flock python tools/generated_docs.py
	@NO_MKDOCS_2_WARNING=true ./flock python -m mkdocs build --strict --site-dir build/site
	@echo "The site is build/site: open build/site/index.html in a browser. The search on it needs a server:"
	@echo "  python3 -m http.server --directory build/site"

figures: setup  ## redraw all figures in docs/figures
	@./flock figures
	@./flock survey --samples 20000 --output docs/figures/survey.png
	@./flock arrange --spans 0.95,0.96,0.97,0.98,1,1.01,1.02,1.03,1.04 --output docs/figures/arrangement.png
	@./flock response --gust 2e-5 --output docs/figures/response.png
	@./flock reference --output runs/figures --force
	@./flock view --picture docs/figures/view.png runs/figures

bench: setup  ## measure throughput
	@./flock python -m pip install --quiet --disable-pip-version-check --no-deps -r requirements/bench.txt
	@./flock python benchmarks/run.py
	@./flock python benchmarks/scaling.py
	@./flock python benchmarks/ensembles.py

clean:  ## remove all build results; recorded flights are kept
	rm -f .venv/flock-stamp build/flock-stamp
	rm -rf .venv build install log .mypy_cache .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -prune -exec rm -rf {} +

help:  ## list these targets
	@sed -n 's/^\([a-z-]*\):[^#]*## \(.*\)/  make \1\t\2/p' Makefile | expand -t 22
