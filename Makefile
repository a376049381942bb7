# make demo   installs, without what only tests need, and runs scheme 1
# make test   installs and runs all checks: format, lint, types, import layers, tests
# make slow   runs the long tests that "make test" omits, and measures again which test runs which line
# make tests-of FILE=hil/maths/quat.py:41  lists the tests of a line, or of all lines of a file
# make oracle compares the truth with Basilisk, in a separate environment
# make numbers measures a tenth of the cases of each number that README and documentation state; ARGUMENTS=--write all
# make bench  measures the cost of a cycle, and of filterpy and Basilisk, in one run
# make lateness measures the lateness of the loop and of cyclictest, in about 10 minutes
# make accessibility checks the console's page with axe-core, which npm installs by its digest
# make docs   builds the documentation site in build/docs; "make docs-links" also follows its links to other sites
# make wheel builds a wheel in dist/ that holds the compiled kernels, for the Python and numba of .venv
# make release builds what a release has: sdists, wheels, documentation, SBOM, hashes; see RELEASING.md
# make tidy   formats the sources

PYTHON ?= python3
BIN := .venv/bin

# packages of the digests in requirements/, and nothing else
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile --require-hashes
EDITABLE := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation \
	--editable . $(addprefix --editable ,$(dir $(wildcard plugins/*/pyproject.toml)))

# one worker runs the tests on wires, which mostly wait, and two run the others
WORKERS := 3

# the C example is built in the tests
CC_MISSING := { apt-get update --quiet && apt-get install --quiet --yes gcc libc6-dev; }

# cameras are tested against libaravis' fake ones; without it those tests are skipped
ARAVIS_MISSING := { apt-get update --quiet && apt-get install --quiet --yes --no-install-recommends libaravis-0.8-0; }

# the console's page is tested in Chromium; without it those tests are skipped
CHROMIUM_MISSING := { apt-get update --quiet && apt-get install --quiet --yes --no-install-recommends chromium; }

# hundreds of processes start, and each worker of the tests rewrites the assertions of all tests that have no bytecode
unexport PYTHONDONTWRITEBYTECODE

# nor does what else a user has set or installed change the tests
unexport PYTHONPATH PYTHONHOME PYTHONOPTIMIZE PYTHONWARNINGS PYTEST_ADDOPTS PYTEST_PLUGINS
PYTEST := $(BIN)/pytest --disable-plugin-autoload -p xdist.plugin -p pytest_timeout -p _hypothesis_pytestplugin \
	-p hil.parts.campaigns.pytest_plugin.plugin

.PHONY: demo test slow tests-of oracle bench numbers lateness accessibility docs docs-links wheel release-pure release tidy
.DELETE_ON_ERROR:

demo: .venv/run
	$(BIN)/hil run scheme-1

test: .venv/ready
	command -v cc > /dev/null || $(CC_MISSING)
	ldconfig -p | grep -q libaravis-0.8 || $(ARAVIS_MISSING) || true
	command -v chromium > /dev/null || $(CHROMIUM_MISSING) || true
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/hil warm-up & kernels=$$!; nice -n 10 $(BIN)/mypy && $(BIN)/lint-imports && wait $$kernels
	$(PYTEST) -m "not slow" -n $(WORKERS) --dist loadgroup --no-loadscope-reorder --durations 25

slow: .venv/ready
	$(PYTEST) -m slow --timeout 3600
	$(BIN)/python -m tests.support.line_tests

tests-of:
	@$(PYTHON) -m tests.support.tests_of $(FILE)

oracle: .venv-oracle/ready
	.venv-oracle/bin/python -m pytest tests/oracle

bench: .venv-oracle/ready
	.venv-oracle/bin/python benchmarks/loop_stages.py
	.venv-oracle/bin/python benchmarks/filters.py
	.venv-oracle/bin/python benchmarks/truth_step.py
	.venv-oracle/bin/python benchmarks/campaign.py

numbers: .venv/ready
	$(BIN)/python sims/stated_numbers.py $(ARGUMENTS)

lateness: .venv/ready
	$(BIN)/python benchmarks/lateness.py

accessibility: .venv/ready
	npm ci --no-audit --no-fund --prefix tests/accessibility
	$(BIN)/pytest -n 0 tests/system/test_page_widths.py

# warnings are errors: dead links, unknown references, failing cells of notebooks;
# DOCS_OPTIONS="--define nb_execution_mode=off" leaves the notebooks to make slow
docs: .venv/docs
	$(BIN)/sphinx-build --quiet --fail-on-warning --nitpicky $(DOCS_OPTIONS) docs build/docs

docs-links: .venv/docs
	$(BIN)/sphinx-build --quiet --builder linkcheck docs build/docs-links

wheel: .venv/ready
	rm -rf hil/kernels
	HIL_CACHE_DIR=hil $(BIN)/hil warm-up
	HIL_WHEEL_KERNELS=1 $(BIN)/python -m pip wheel --quiet --no-deps --no-build-isolation --wheel-dir dist .

# what is the same on each computer: sdists and pure wheels of the program and its plug-ins, documentation, SBOM
release-pure: docs .venv-audit/ready
	for each in . plugins/*/; do \
		(cd $$each && $(CURDIR)/$(BIN)/python -m hatchling build --directory $(CURDIR)/dist) || exit; done
	tar -C build -czf dist/hil-bench-docs.tar.gz docs
	.venv-audit/bin/cyclonedx-py requirements requirements/run.txt --output-file dist/sbom.cdx.json

release:
	rm -rf dist
	$(MAKE) release-pure wheel
	cd dist && sha256sum * > SHA256SUMS
	.venv-audit/bin/twine check --strict dist/hil_*

tidy: .venv/ready
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

# what runs the program; repeated only after a change of the dependencies
.venv/run: pyproject.toml $(wildcard plugins/*/pyproject.toml) requirements/build.txt requirements/run.txt
	$(PYTHON) -m venv .venv
	$(INSTALL) --requirement requirements/build.txt --requirement requirements/run.txt
	$(EDITABLE)
	touch $@

# what tests need, too
.venv/ready: .venv/run requirements/dev.txt
	$(INSTALL) --requirement requirements/dev.txt
	$(BIN)/python -m compileall -q -j 0 .venv/lib > /dev/null || true  # on all cores; some packages hold templates
	touch $@

.venv/docs: .venv/ready requirements/docs.txt
	$(INSTALL) --requirement requirements/docs.txt
	touch $@

# tools of the release, which are no part of the program
.venv-audit/ready: requirements/audit.txt
	$(PYTHON) -m venv .venv-audit
	.venv-audit/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes --requirement $<
	touch $@

# Basilisk needs an older matplotlib than constraints.txt pins
.venv-oracle/ready: pyproject.toml constraints-oracle.txt
	$(PYTHON) -m venv .venv-oracle
	.venv-oracle/bin/python -m pip install --quiet --disable-pip-version-check --constraint constraints-oracle.txt \
		--editable '.[oracle]'
	touch $@
