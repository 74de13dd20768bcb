.DEFAULT_GOAL := help
PYTHON ?= python3
BIN := .venv/bin
WORKERS ?= 2

help:  ## show this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | awk -F ':.*## ' '{printf "  make %-12s %s\n", $$1, $$2}'

setup: .venv/.done  ## make .venv with the tested versions

.venv/.done: pyproject.toml constraints.txt
	@echo "deepir and its tools are installed into .venv; this takes some minutes, once"
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --constraint constraints.txt --editable '.[dev,compare,docs,hdf5,video,live]'
	$(BIN)/python -c "from deepir.kernels import ahead; ahead.compile_everything()"
	@touch $@

demo: setup  ## correct a simulated burst; results and pictures in runs/demo/
	$(BIN)/deepir demo

test: setup lint  ## lint and tests
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder -m "not slow and not matrix"

test-all: setup lint  ## lint and all tests, the slow ones too
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder

lint: setup  ## ruff, mypy, and the size of the package against its budget
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python benchmarks/size.py

docs: setup  ## the documentation as a site, in site/
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict
	@echo "to look at it: $(BIN)/python -m http.server --directory site 8000, then http://localhost:8000"

golden: setup  ## small bursts of all problems against their kept results: two minutes
	$(BIN)/python benchmarks/golden.py

bench: setup  ## the benchmark of record, a part of it: all methods, a quarter of an hour on two cores
	$(BIN)/python benchmarks/record.py

bench-full: setup  ## the benchmark of record, all of it: hours; goes on where it was interrupted
	$(BIN)/python benchmarks/record.py --full

bench-nuc: setup  ## quality against the oracle, and speed: non-uniformity correction
	$(BIN)/python benchmarks/nuc.py --output notes/bench-nuc.md

bench-sr: setup  ## quality against the oracle, and seconds: super-resolution
	$(BIN)/python benchmarks/sr.py

bench-lag: setup  ## the time constant, and quality against ignoring it: thermal lag
	$(BIN)/python benchmarks/lag.py

bench-multiview: setup  ## quality and seconds: frames of different scenes
	$(BIN)/python benchmarks/multiview.py

bench-flow: setup  ## dense motion: simulated parallax, and a held-out frame of a real burst
	$(BIN)/python benchmarks/flow.py --output notes/bench-flow.md

bench-narcissus: setup  ## quality against the oracle, and seconds: stray flux
	$(BIN)/python benchmarks/narcissus.py --output notes/bench-narcissus.md

bench-deconv: setup  ## quality against scikit-image's, and the widths found: deconvolution
	$(BIN)/python benchmarks/deconv.py

bench-priors: setup  ## quality and time of every prior, goes on where it was cut short
	$(BIN)/python benchmarks/priors.py --workers $(WORKERS) --output notes/bench-priors.md --panels docs/images/priors.png

bench-paper: setup  ## the 2021 formulation and every prior on its paper's protocol: an hour and more, goes on
	$(BIN)/python benchmarks/paper.py --workers $(WORKERS) --output notes/bench-paper.md

bench-switches: setup  ## what a network's switches gain in time, and cost in quality
	$(BIN)/python benchmarks/switches.py --workers $(WORKERS)

bench-problems: setup  ## every problem with several priors: one table
	$(BIN)/python benchmarks/problems.py --output notes/bench-problems.md

bench-live: setup  ## live correction: delay, memory, quality over time: half an hour
	$(BIN)/python benchmarks/live.py --output docs/benchmarks/live.md --plot docs/images/live-quality.png

bench-frameworks: setup  ## deblurring and super-resolution beside deepinv and SigPy, where they are installed
	$(BIN)/python benchmarks/frameworks.py --output docs/benchmarks/frameworks.md

bench-effects: setup  ## what each effect is worth: one left out at a time
	$(BIN)/python benchmarks/effects.py --output notes/bench-effects.md

bench-recordings: setup  ## recordings of many kinds, ours and rivals, by what is known of each: hours, goes on
	$(BIN)/python benchmarks/bench_recordings.py --workers $(WORKERS) --page

bench-misfit: setup  ## faults of a burst, and whether they are named
	$(BIN)/python benchmarks/misfit.py --workers $(WORKERS) --output docs/benchmarks/misfit.md

bench-real: setup  ## real bursts, from the folder that DEEPIR_DATA names
	$(BIN)/python benchmarks/real.py

bench-gpu: setup  ## seconds and quality of whole solves on a GPU, where there is one
	$(BIN)/python benchmarks/gpu.py

reliability: setup  ## damaged inputs, kills, full disks, flipped bits, races: two hours, goes on where it was cut short
	$(BIN)/python benchmarks/reliability.py --workers $(WORKERS) --output docs/benchmarks/reliability.md

bench-speed: setup  ## seconds and memory of whole commands, written into docs/benchmarks/overview.md
	$(BIN)/python benchmarks/speed.py --page

clean:  ## remove .venv and caches
	rm -rf .venv build dist site .pytest_cache .mypy_cache .ruff_cache

.PHONY: reliability golden help setup demo test test-all lint docs bench bench-full bench-nuc bench-sr bench-lag bench-multiview bench-flow bench-narcissus bench-deconv bench-priors bench-problems bench-paper bench-switches bench-real bench-recordings bench-live bench-effects bench-misfit bench-frameworks bench-gpu bench-speed clean
