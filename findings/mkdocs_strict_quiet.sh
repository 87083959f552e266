#!/usr/bin/env bash
# mkdocs: --quiet turns --strict off, since the warnings that --strict counts are dropped before they are counted.
set -euo pipefail
folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet mkdocs==1.6.1
mkdir -p "$folder/site/docs"
echo 'site_name: A page with a link that leads nowhere' >"$folder/site/mkdocs.yml"
echo 'See [the other page](missing.md).' >"$folder/site/docs/index.md"
cd "$folder/site"

"$folder/venv/bin/python" -m mkdocs --version
loud=0
"$folder/venv/bin/python" -m mkdocs build --strict >/dev/null 2>&1 || loud=$?
quiet=0
"$folder/venv/bin/python" -m mkdocs build --strict --quiet >/dev/null 2>&1 || quiet=$?
echo "exit codes of a site with a broken link: --strict $loud, --strict --quiet $quiet"
[ "$loud" -eq 1 ] && [ "$quiet" -eq 0 ]
