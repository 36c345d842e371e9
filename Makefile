# The pipeline from an empty machine to a report. `make demo` and `make test` need only git, make
# and Python 3.10 to 3.13; everything is installed into .venv on first use.
SUITABLE := import sys; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 13))
PYTHON ?= $(shell for p in python3 python3.13 python3.12 python3.11 python3.10; do \
	$$p -c '$(SUITABLE)' 2>/dev/null && echo $$p && break; done)
BIN := .venv/bin
STAMP := .venv/installed
DEVELOPER := .venv/complete
DATASET ?= outputs/dataset
CAPTURE ?= examples/captures/twill
PHOTOGRAPH ?= examples/captures/twill_photograph
PULLED ?= examples/tension/twill
ROUNDED ?= tests/sim tests/data tests/drapenet
PACKAGES := apps benchmarks common configs data drapenet examples experiments sim tests tools
CHECKS := check-types check-versions check-unused check-layers check-docstrings check-spelling check-style

.PHONY: $(CHECKS) help setup demo test test-rounding test-wheel test-notebooks test-slow test-slurm test-browser serve lint sim prior dataset train evaluate bench-sim bench docs reference example matrix clean

help:  ## this list
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## /\1\t/' | expand -t 12

setup: $(DEVELOPER)  ## system libraries, .venv and all packages, of training and tests, too

$(STAMP): pyproject.toml constraints.txt
	@test -n "$(PYTHON)" && $(PYTHON) -c '$(SUITABLE)' || \
	  { echo "Python 3.10 to 3.13 is needed; run: make PYTHON=/path/to/python3.13" >&2; exit 2; }
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	@echo "installing packages into .venv (a minute or two; 1.6 GB) ..."
	$(BIN)/python -m pip install -qq --constraint constraints.txt --editable .
	touch $@

$(DEVELOPER): $(STAMP) tools/system_libraries.sh tools/cpu_torch.sh
	sh tools/system_libraries.sh
	@echo "installing packages of training and tests (a few minutes; 8 GB, 3 GB without CUDA libraries) ..."
	sh tools/cpu_torch.sh $(BIN)/python
	$(BIN)/python -m pip install -qq --constraint constraints.txt --editable '.[dev]'
	touch $@

demo: $(STAMP)  ## estimate a fabric from two bundled captures: a photograph and depth views
	$(BIN)/python infer.py capture=[$(PHOTOGRAPH),$(CAPTURE)] out=outputs/demo

test: $(DEVELOPER)  ## fast tests, six minutes and a half on two idle cores
	$(BIN)/python -m pytest -q -n logical --maxprocesses 8 --dist worksteal

test-rounding: $(DEVELOPER)  ## tests of drapes, captures and estimates with the rounding of an old processor, 10 minutes
	$(BIN)/python tools/other_processor.py $(BIN)/python -m pytest -q -n logical --maxprocesses 8 \
	  --dist worksteal $(ROUNDED)

test-wheel: $(DEVELOPER)  ## build the wheel and use it without the checkout, 3 minutes
	$(BIN)/python tools/wheel_trial.py

test-notebooks: $(DEVELOPER)  ## run the notebooks of docs as in Jupyter, 2 minutes
	$(BIN)/python -m pytest -q --nbmake -n logical --maxprocesses 3 docs

test-slow: $(DEVELOPER)  ## tests that take minutes
	$(BIN)/python -m pytest -q -m slow

test-slurm: $(DEVELOPER)  ## tests of datasets on a one-node Slurm, installed and started if run as root
	$(BIN)/python -m pytest -q -rs -m slurm tests/data/test_slurm.py

test-browser: $(DEVELOPER)  ## tests of the page in Chromium, installed if run as root; screenshots in outputs/browser
	@test -n "$$(command -v chromium)" || test "$$(id -u)" != 0 || { apt-get update -qq && apt-get install -qqy chromium; }
	$(BIN)/python -m pip install -qq --constraint constraints.txt --editable '.[dev,browser]'
	$(BIN)/python -m pytest -q -rs -m browser tests/browser

serve: $(STAMP)  ## run the page and the HTTP interface on http://localhost:8000
	$(BIN)/python serve.py

matrix: $(DEVELOPER)  ## test the installed wheel with each Python from 3.10 to 3.13, 1.6 GB and a few minutes each
	$(BIN)/python -m nox -f tools/matrix.py

lint: $(DEVELOPER)  ## check style, imports between packages, units in docstrings, unused code, types, spelling
	@$(MAKE) --no-print-directory --jobs --keep-going --output-sync=target $(CHECKS)

check-style:
	$(BIN)/ruff check .
check-versions:
	$(BIN)/vermin -q --target=3.10- --violations --eval-annotations --no-parse-comments --exclude file $(PACKAGES) *.py
check-layers:
	$(BIN)/lint-imports --no-cache --no-logo
check-docstrings:
	$(BIN)/python tools/check_docstrings.py
check-unused:
	$(BIN)/python -m vulture
check-types:
	$(BIN)/python -m mypy --num-workers 2
check-spelling:
	$(BIN)/python -m codespell_lib README.md docs/*.md *.py $(PACKAGES)

sim: $(STAMP)  ## simulate one drape, results in outputs/drape
	$(BIN)/python -m apps.drape

prior: $(DEVELOPER)  ## fit a prior to your table: make prior TABLE=fabrics.csv
	$(BIN)/python -m data.fabrics.prior fit fabrics=$(TABLE)

dataset: $(DEVELOPER)  ## simulate drapes of many testers, both faces and several specimens of each fabric
	$(BIN)/python -m data.dataset.generate dataset=testers drapes=20480 seed=84 edge_mm=4 out=$(DATASET)

train: $(DEVELOPER)  ## train the network on them, resumes when interrupted
	$(BIN)/python train.py data=$(DATASET) out=outputs/train

evaluate: $(DEVELOPER)  ## errors and coverage of the bundled network on unseen fabrics, by tester and input
	$(BIN)/python -m drapenet.network.evaluate bounds=docs/validation/bounds.json

bench-sim: $(DEVELOPER)  ## time drapes on this machine, JSON in outputs/experiments
	$(BIN)/python -m experiments speed

bench: $(DEVELOPER)  ## timings of drapes and estimates on this machine, JSON in docs/validation
	for name in speed cold; do $(BIN)/python -m experiments $$name out=docs/validation/$$name.json || exit 1; done

docs: $(DEVELOPER)  ## update the figures in README.md and docs/*.md from the demo and the reports
	mkdir -p outputs
	$(BIN)/python infer.py capture=[$(PHOTOGRAPH),$(CAPTURE)] out=outputs/demo > outputs/demo.txt
	cp outputs/demo.txt docs/validation/demo.txt
	$(BIN)/python infer.py capture=$(PHOTOGRAPH) tension=$(PULLED) export=clo \
	  out=outputs/fifteen_minutes > outputs/fifteen_minutes.txt
	cp outputs/fifteen_minutes.txt docs/validation/fifteen_minutes.txt
	$(BIN)/python -m experiments.figures

reference: $(DEVELOPER)  ## pages of the Python interface from its docstrings, outputs/reference/index.html
	$(BIN)/python tools/reference.py outputs/reference

example: $(DEVELOPER)  ## make the bundled capture again
	$(BIN)/python examples/make_capture.py out=$(CAPTURE)
	$(BIN)/python examples/make_capture.py out=$(PHOTOGRAPH) photograph=true \
	  tester=disc300_support180 seed=3

clean:  ## remove outputs and build (not .venv)
	rm -rf outputs build
