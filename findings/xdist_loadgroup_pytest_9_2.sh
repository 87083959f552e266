#!/usr/bin/env bash
# pytest-xdist: with pytest 9.2 `--dist loadgroup` groups nothing, without a warning. xdist adds the group to `item._nodeid`, and that pytest
# takes the name of a test from another attribute: tests of one `xdist_group` run in several processes, under names without "@group", and a
# fixture of their module is made once in each. With pytest 9.1 they share a process. `--dist loadfile` keeps a file's tests together in both.
set -euo pipefail
folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
cd "$folder"
cat >test_group.py <<'PYTHON'
import os
import time

import pytest


@pytest.mark.xdist_group("shared")
@pytest.mark.parametrize("number", range(6))
def test_where(number):
    time.sleep(0.3)
    with open("where.txt", "a") as file:
        file.write(os.environ["PYTEST_XDIST_WORKER"] + "\n")
PYTHON
run() { # a version of pytest, the kind of distribution, how many processes are expected
    local venv="$folder/pytest-$1" count
    if [ ! -d "$venv" ]; then
        python3 -m venv "$venv"
        "$venv/bin/python" -m pip install --quiet "pytest==$1" pytest-xdist==3.8.0
    fi
    rm -f where.txt
    "$venv/bin/python" -m pytest -q -p no:cacheprovider -n 2 --dist "$2" >log.txt 2>&1 || { cat log.txt && exit 1; }
    count="$(sort -u where.txt | wc -l)"
    echo "pytest $1, pytest-xdist 3.8.0, --dist $2: six tests of one group ran in $count process(es)"
    [ "$count" -eq "$3" ]
}
run 9.1.0 loadgroup 1
run 9.2.0 loadgroup 2
run 9.2.0 loadfile 1
