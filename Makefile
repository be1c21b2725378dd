# SPDX-License-Identifier: Apache-2.0
# PYTHON=python3.12 chooses the Python; PYTEST_ARGS="-k name" goes to pytest.

.PHONY: setup demo test torture lint docs bench figures clean help

setup:  ## build .venv and the workspace where missing or stale (all others do it themselves)
	@tools/setup

demo: setup  ## fly 13 geese over ROS 2 to their steady state, record, measure and report on them
	@./flock fly --output runs/demo --force
	@./flock picture runs/demo
	@./flock report runs/demo
	@echo
	@echo "The bag is runs/demo, with the picture of the formation and the report in it: open runs/demo/report.html"
	@echo "in a browser. The same flight without ROS, to the bit:"
	@echo "  ./flock reference --output runs/reference && ./flock compare runs/demo runs/reference"

test: setup  ## run all tests
	@./flock python -m pytest $(PYTEST_ARGS)

torture: setup  ## kill the processes of flights a hundred times at random, and pelt a bird with forgeries
	@cd tests && ../flock python torture.py $(TORTURE_ARGS)
	@FLOCK_TORTURE=1 ./flock python -m pytest -q tests/unit/test_stage_fuzz.py

lint: setup  ## check style and types
	@./flock python -m ruff check
	@./flock python -m ruff format --check
	@./flock python -m mypy

docs: setup  ## write docs/tools.md and docs/messages.md anew, and build the site in build/site
	@./flock python -m pip install --quiet --disable-pip-version-check --no-deps -r requirements/docs.txt
	@./flock python tools/generated_docs.py
	@NO_MKDOCS_2_WARNING=true ./flock python -m mkdocs build --strict --site-dir build/site
	@echo "The site is build/site: open build/site/index.html in a browser. Its search needs a server:"
	@echo "  python3 -m http.server --directory build/site"

figures: setup  ## redraw all figures in docs/figures
	@./flock figures
	@./flock survey --samples 20000 --output docs/figures/survey.png
	@./flock reference --output runs/figures --force
	@./flock view --picture docs/figures/view.png runs/figures

bench: setup  ## measure throughput
	@if grep -q '^[^#]' requirements/bench.txt; then \
		./flock python -m pip install --quiet --no-deps -r requirements/bench.txt; fi
	@./flock python benchmarks/run.py
	@./flock python benchmarks/scaling.py

clean:  ## remove all that was built; recorded flights stay
	rm -rf .venv build install log .mypy_cache .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -prune -exec rm -rf {} +

help:  ## list these targets
	@sed -n 's/^\([a-z]*\):[^#]*## \(.*\)/  make \1\t\2/p' Makefile | expand -t 16
