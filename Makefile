# lightopt: everything a developer or a batch run needs. `make help` lists the targets.
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
OUT    ?= out

# commands that tests and batches start load compiled modules; without, each of them compiles the package anew
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.PHONY: help install lock demo plan batch test test-all test-nightly coverage check golden golden-check bench docs docs-site clean

help:  ## this list
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 16

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

# what is imported is compiled then; compiling all of it takes a third of the time. The lock has what anything needs
$(BIN)/.installed: pyproject.toml requirements/dev.lock | $(BIN)/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile --no-deps --require-hashes --requirement requirements/dev.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	@touch $@

install: $(BIN)/.installed  ## a virtual environment in .venv with lightopt and the tools to develop it

lock: $(BIN)/.installed  ## renew the exact versions of requirements/*.lock within the ranges of pyproject.toml
	$(BIN)/python scripts/lock.py

RIG   ?= configs/rigs/four-panel.yaml
PART  ?= configs/parts/cover-knob.yaml
PARTS ?= configs/parts
STEP  ?= 5
VALUES = grep -E '^ +(R_d|R_s|sigma_rad):' $(1) | sed -E 's/\#.*//' | tr -s ' \n' ' '

demo: $(BIN)/.installed  ## the whole loop on the sample: render, fit, plan the lights for defects, capture, inspect; into out/demo…
	$(BIN)/lightopt render $(RIG) $(PART) -o $(OUT)/demo --sheet
	$(BIN)/lightopt render $(RIG) $(PART) -o $(OUT)/demo-noisy --noise 1 --exposure 1,1/16 --posture 0,0
	$(BIN)/lightopt fit-specular $(RIG) $(PART) $(OUT)/demo-noisy -o $(OUT)/demo-fit --joint
	@echo "true:      $$($(call VALUES,$(PART)))"
	@echo "recovered: $$($(call VALUES,$(OUT)/demo-fit/part.fitted.yaml))"
	$(BIN)/lightopt optimize $(RIG) $(PART) -o $(OUT)/demo-best --objective detectability
	$(BIN)/lightopt capture $(RIG) $(PART) -o $(OUT)/demo-captured --posture 0,82 --exposure 1,1/16 --resume
	$(BIN)/lightopt fit-diffuse $(RIG) $(PART) $(OUT)/demo-captured -o $(OUT)/demo-captured-fit
	$(BIN)/lightopt defects $(OUT)/demo-best/rig.optimized.yaml $(PART) -o $(OUT)/demo-defects.yaml --seed 4 --count 8
	$(BIN)/lightopt capture $(OUT)/demo-best/rig.optimized.yaml $(OUT)/demo-defects.yaml -o $(OUT)/demo-with-defects --posture 0,0 --resume
	$(BIN)/lightopt inspect $(OUT)/demo-best/rig.optimized.yaml $(OUT)/demo-defects.yaml $(OUT)/demo-with-defects -o $(OUT)/demo-inspected --evaluate
	@echo "what the optimisation found: $(OUT)/demo-best/report.html"
	@echo "what the inspection found: $(OUT)/demo-inspected/report.html"

plan: $(BIN)/.installed  ## the sample planned: which postures, lights and exposures, how exact the angles, then its images; into out/plan…
	$(BIN)/lightopt optimize $(RIG) $(PART) -o $(OUT)/plan --choose-postures 2 --posture-step 45 \
	    --exposure 1/16,1/4,1,4,16 --light-tolerance 2 --pose-tolerance 1 --patches 50000 --no-images
	@# the commands that the plan ends with, the capture as a list of what would be done
	export PATH="$(abspath $(BIN)):$$PATH" && cd $(OUT)/plan && \
	    commands="$$(python -c 'import json; print(*json.load(open("result.json", encoding="utf-8"))["commands"], sep="\n")')" && \
	    printf '%s\n' "$$commands" | sed -e '/lightopt capture/s/$$/ --dry-run/' -e '/lightopt render/s/$$/ --sheet/' | sh -ex
	@echo "what was planned: $(OUT)/plan/report.html"

define BATCH
format: lightopt-batch/1
rigs: ["$(abspath $(RIG))"]
parts: ["$(abspath $(PARTS))"]
jobs:
  - {name: check, command: check}
  - {name: images, command: render, needs: [check]}
  - {name: best, command: optimize, needs: [images], options: {step: $(STEP)}}
endef
export BATCH

batch: $(BIN)/.installed  ## check, render and optimise every part: make batch RIG=rig.yaml PARTS=folder STEP=5
	@mkdir -p $(OUT)
	@printf '%s\n' "$$BATCH" >$(OUT)/batch.yaml
	$(BIN)/lightopt batch $(OUT)/batch.yaml -o $(OUT)/batch

# as many workers as tests/conftest.py says; modules, whose tests share what takes long, in the order that it gives them
PYTEST = $(BIN)/python -m pytest --numprocesses=auto --dist=loadscope --no-loadscope-reorder

test: $(BIN)/.installed  ## the tests that take less than five minutes
	$(PYTEST) -m "not slow and not nightly"

test-all: $(BIN)/.installed  ## all tests but the long statistics
	$(PYTEST) -m "not nightly"

test-nightly: $(BIN)/.installed  ## the long statistics and campaigns, and Hypothesis with 15 times the examples
	$(PYTEST) -m "nightly or hypothesis" --hypothesis-profile=nightly

coverage: $(BIN)/.installed  ## share of the code that all tests but the long statistics run, without compiled kernels; out/coverage
	$(PYTEST) -m "not nightly" --cov --cov-report=term:skip-covered --cov-report=html:$(OUT)/coverage

check: $(BIN)/.installed  ## formatting, lint, types, layers
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/pyright --pythonpath $(BIN)/python
	$(BIN)/lint-imports

golden-check: $(BIN)/.installed  ## render the golden scenes anew and compare them with what is committed
	$(BIN)/python scripts/goldens.py check --out $(OUT)/golden

golden: $(BIN)/.installed  ## renew the committed golden images
	$(BIN)/python scripts/goldens.py renew

# peers bring packages that change how tests run, so they have an environment of their own, in which they change no
# version of what is locked; pip takes no constraints with hashes where the rest has none
BENCH ?= .venv-bench
PEERS  = 'mitsuba>=3.6' 'open3d>=0.19'
$(BENCH)/.installed: pyproject.toml requirements/dev.lock
	$(PYTHON) -m venv $(BENCH)
	$(BENCH)/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes --requirement requirements/dev.lock
	$(BENCH)/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	sed -e '/^ *--hash/d' -e 's/ *\\$$//' requirements/dev.lock >$(BENCH)/constraints.txt
	@touch $@

# one that cannot be installed is left out, as one that does not run is; the next make bench tries it again
$(BENCH)/.peers: $(BENCH)/.installed
	@all=true; for peer in $(PEERS); do \
	    $(BENCH)/bin/python -m pip install --quiet --disable-pip-version-check \
	        --constraint $(BENCH)/constraints.txt $$peer \
	        || { all=false; echo "$$peer cannot be installed and is left out; the next make bench tries it again"; }; \
	done; if $$all; then touch $@; fi

bench: $(BENCH)/.peers  ## speed against the raw ray caster and peers; prints ratios; BENCHMARKS="peers --quick" for a part
	$(BENCH)/bin/python -m benchmarks.run $(BENCHMARKS)

docs: $(BIN)/.installed  ## make the pictures and figures of docs/ anew
	PYTHONPATH=tests:. $(BIN)/python scripts/make_docs.py

SITE ?= .venv-docs
$(SITE)/.installed: requirements/docs.lock
	$(PYTHON) -m venv $(SITE)
	$(SITE)/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --require-hashes --requirement requirements/docs.lock
	@touch $@

docs-site: $(SITE)/.installed  ## build the documentation site into out/site; a broken link is an error
	NO_MKDOCS_2_WARNING=1 $(SITE)/bin/python -m mkdocs build --strict --quiet --site-dir $(OUT)/site
	@echo "$(OUT)/site/index.html"

clean:  ## remove what was made, but not the virtual environment
	rm -rf $(OUT) build dist *.egg-info .pytest_cache .ruff_cache .hypothesis .import_linter_cache
