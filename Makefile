# make demo    .venv, pinned installs, then the main job: render, remove the gloss, measure, report
# make test    the whole test suite on the same .venv
# make check   formatting, lint and types
# make bench   figures of README and docs (the tables of networks and of sets name their own commands)
# make soak    long campaigns (none are needed to use the software)

PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
WORKERS ?= 2
STAMP := $(VENV)/.installed

.PHONY: demo test check bench soak clean

demo: $(STAMP)
	$(BIN)/degloss demo -o out/demo

test: $(STAMP)
	$(BIN)/python -m pytest -q -m "not soak and not alone" -n $(WORKERS) --dist loadfile
	$(BIN)/python -m pytest -q -m "alone and not soak"

bench: $(STAMP)
	$(BIN)/python -m recon.bench
	$(BIN)/python -m recon.normals.bench
	$(BIN)/python -m recon.repair.bench
	rm -rf out/bench-multiview && $(BIN)/degloss recon bench multiview -o out/bench-multiview --workers $(WORKERS)
	$(BIN)/python -m recon.height.bench
	$(BIN)/python -m gen.bench
	$(BIN)/python -m gen.deviation
	$(BIN)/python -m learn.real
	$(BIN)/python -m learn.speed

soak: $(STAMP)
	$(BIN)/python -m pytest -q -m soak

check: $(STAMP)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install -q -c constraints.txt -e '.[render,report,learn,train,export,cluster,views,release,dev]'
	touch $@

clean:
	rm -rf $(VENV) out build *.egg-info
