#!/bin/sh
# The page in a real browser: page.mjs. make copies this to BUILD/tests/page/test_page, for tests/run.sh.
exec node tests/page/page.mjs "${0%/tests/page/test_page}"
