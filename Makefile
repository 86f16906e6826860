# Everything runs in .venv, which is made on first use; stamp files make repeats cheap.
PYTHON ?= python3
BIN := .venv/bin
PIP_INSTALL := $(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt

.PHONY: demo test lint docs warmup clean

demo: .venv/.core  ## render the built-in scene, estimate it and draw the result
	@mkdir -p out
	$(BIN)/inhand demo --out out/demo.png

test: lint docs  ## everything that must hold before a commit
	$(BIN)/pytest

lint: .venv/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

docs: .venv/.dev  ## build the documentation site into out/docs; a warning is an error
	$(BIN)/sphinx-build --quiet --fresh-env --fail-on-warning docs out/docs

warmup: .venv/.core  ## compile all kernels ahead of the first estimate
	$(BIN)/inhand warmup

clean:
	rm -rf .venv out build dist

.venv/.created:
	$(PYTHON) -m venv .venv
	@touch $@

.venv/.core: .venv/.created pyproject.toml constraints.txt
	$(PIP_INSTALL) -e .
	@touch $@

.venv/.dev: .venv/.created pyproject.toml constraints.txt
	$(PIP_INSTALL) -e '.[bench,ray,streams,viewer,docs,dev]'
	@touch $@ .venv/.core
