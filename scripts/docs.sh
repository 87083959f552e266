#!/usr/bin/env bash
# Sets everything up in .venv of this checkout and builds the documentation site into site/. A warning is an error.
# --films: film every scene of the gallery first (some minutes; kept in build/films/).
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"
films=no
for word in "$@"; do
    if [ "$word" != --films ]; then die "$word: the only option is --films"; fi
    films=yes
done
set_up docs
cd "$root"
if [ "$films" = yes ]; then "$venv/bin/python" scripts/site_pages.py --films; fi
NO_MKDOCS_2_WARNING=1 "$venv/bin/python" -m mkdocs build --strict
say "The site is in $root/site: open index.html, or, to search in it, serve it: $venv/bin/python -m http.server -d $root/site"
