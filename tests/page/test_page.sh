#!/bin/sh
# The page in a real browser: page.mjs. make copies this to BUILD/tests/page/test_page, for tests/run.sh.
build=${0%/tests/page/test_page}
tests/page/install.sh "$build/page" && exec node tests/page/page.mjs "$build"
