# Sourced by demo.sh, test.sh and docs.sh, never run by itself. It sets `root` (the checkout) and `venv`, and defines
#   set_up run|docs|dev    make the virtual environment .venv, install the package in it, see to dm-control and to OpenGL
#   see_to_compiling       compile what engines and laws call (tests call all of it; the demo and the site compile what they call)
# A second call with nothing changed installs nothing and needs no network.

root="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)"
venv="$root/.venv"
compiling= # the process that compiles beside the installation

say() { printf '%s\n' "$*" >&2; }

die() {
    say "error: $*"
    exit 1
}

is_python() { # python newest: whether it is Python 3.11 to 3.<newest>, and can make environments
    "$1" -c 'import sys, venv
sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, int(sys.argv[1])))' "$2" >/dev/null 2>&1
}

find_python() {
    local candidate newest
    if [ -n "${PYTHON:-}" ]; then
        if ! command -v "$PYTHON" >/dev/null || ! is_python "$PYTHON" 99; then
            die "PYTHON=$PYTHON is no Python 3.11 or newer with the module venv; name another, or unset PYTHON"
        fi
        command -v "$PYTHON"
        return
    fi
    for newest in 14 99; do
        for candidate in python3 python3.14 python3.13 python3.12 python3.11 python; do
            if command -v "$candidate" >/dev/null && is_python "$candidate" "$newest"; then
                if [ "$newest" = 99 ]; then say "$candidate is newer than 3.14, the newest that this was tried with"; fi
                command -v "$candidate"
                return
            fi
        done
    done
    die "Python 3.11 or newer is needed and was not found; install it, or name it: PYTHON=/path/to/python3"
}

# What an installation depends on: the kind, the Python, the place (an editable install holds absolute paths), pyproject.
fingerprint() {
    "$1" - "$2" "$root" <<'PYTHON'
import hashlib, pathlib, sys

kind, root = sys.argv[1:]
files = [pathlib.Path(root) / name for name in ("pyproject.toml", "evidence/pyproject.toml")]
text = "\n".join([kind, "with pip", sys.version, root, *(file.read_text(encoding="utf-8") for file in files if file.exists())])
print(hashlib.sha256(text.encode()).hexdigest())
PYTHON
}

has_pip() { "$1" -m pip --version >/dev/null 2>&1; }

pip_is_at_least() { # python major minor
    "$1" -c 'import sys, pip
version = tuple(int(part) for part in pip.__version__.split(".")[:2])
sys.exit(version < (int(sys.argv[1]), int(sys.argv[2])))' "$2" "$3" >/dev/null 2>&1
}

# Debian may lack ensurepip (package python3-venv), so the environment borrows the pip of the system.
pip_install() { # python, then arguments of pip install
    local python="$1"
    shift
    if has_pip "$venv/bin/python"; then
        "$venv/bin/python" -m pip install "$@"
    elif has_pip "$python" && pip_is_at_least "$python" 22 3; then
        "$python" -m pip --python "$venv/bin/python" install "$@"
    elif has_pip "$python"; then # too old for --python: put a new pip into the environment first
        "$python" -m pip install --quiet --target "$("$venv/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')" "pip>=22.3"
        "$venv/bin/python" -m pip install "$@"
    elif "$venv/bin/python" -m ensurepip --upgrade >/dev/null 2>&1; then
        "$venv/bin/python" -m pip install "$@"
    else
        die "pip is needed and $python has none; on Debian: apt-get install python3-pip"
    fi
}

pinned_for() { # extra python: its requirements of one version each, a line each
    "$2" -c 'import sys, tomllib
with open(sys.argv[2], "rb") as file:
    wanted = tomllib.load(file)["project"]["optional-dependencies"][sys.argv[1]]
print(*(one for one in wanted if "==" in one), sep="\n")' "$1" "$root/pyproject.toml"
}

install_package() { # python run|docs|dev
    local python="$1" kind="$2" wanted stamp="$venv/.installed-$2" packages=(--editable "$root[studies,allocation,fatigue,ntrt,completion]")
    local options=(--disable-pip-version-check --no-warn-conflicts)
    wanted="$(fingerprint "$python" "$kind")"
    if [ -x "$venv/bin/python" ] && [ "$(cat "$stamp" 2>/dev/null)" = "$wanted" ]; then
        return
    fi
    # An environment of another Python or another place cannot be mended, only made anew.
    if ! [ "$(cat "$venv/.made-for" 2>/dev/null)" = "$root $("$python" -c 'import sys; print(sys.version)' | tr '\n' ' ')" ] ||
        ! is_python "$venv/bin/python" 99; then
        say "Making the virtual environment $venv with $("$python" --version)"
        "$python" -m venv --clear --without-pip "$venv"
        printf '%s %s' "$root" "$("$python" -c 'import sys; print(sys.version)' | tr '\n' ' ')" >"$venv/.made-for"
    fi
    if [ "$kind" != run ]; then packages=(--editable "$root[$kind]" --editable "$root/evidence"); fi
    # Tests import half of what they need, on all cores; pip would compile the bytecode of all of it, on one.
    if [ "$kind" = dev ]; then options+=(--no-compile); fi
    if ! [ -t 2 ]; then options+=(--quiet); fi # pip's own progress is for whoever watches
    say "Installing the package and what it needs (once; a few minutes on a slow line)"
    rm -f "$venv/.dm-control-tried" "$venv/.opengl-works" "$venv/.compiled"
    if [ "$kind" = dev ]; then
        # All functions are compiled beside what installs the other half, at the versions that this will ask for.
        local pinned
        mapfile -t pinned < <(pinned_for dev "$python")
        pip_install "$python" "${options[@]}" --editable "$root" "${pinned[@]}" >&2
        see_to_compiling &
        compiling=$!
    fi
    # With a pip of its own, so that `.venv/bin/python -m pip install` of the guides and of `doctor` works.
    # Of what an earlier run installed only dm-control can conflict, by the labmaze that it is used without.
    if ! pip_install "$python" "${options[@]}" "${packages[@]}" "pip>=22.3" >&2; then
        if [ -n "$compiling" ]; then kill "$compiling" 2>/dev/null || true; fi
        exit 1
    fi
    printf '%s' "$wanted" >"$stamp"
    # What the tests need includes what the site needs, and that what the demo needs.
    if [ "$kind" = dev ]; then fingerprint "$python" docs >"$venv/.installed-docs"; fi
    if [ "$kind" != run ]; then fingerprint "$python" run >"$venv/.installed-run"; fi
}

# Requirements of tensegrity_mj.learning.dm_control that are not met, one a line.
missing_for_dm_control() {
    "$venv/bin/python" -c 'from tensegrity_mj.basics.dependencies import missing_for_dm_control as missing
print(*missing(), sep="\n", end="")'
}

install_dm_control() { # python, then the requirements that are not met
    local python="$1" pip=(pip_install "$1" --quiet --disable-pip-version-check) item needs=() alone=()
    shift
    for item in "$@"; do
        if [[ "$item" = dm-control* ]]; then alone+=("$item"); else needs+=("$item"); fi
    done
    if [ "${#needs[@]}" -gt 0 ]; then "${pip[@]}" "${needs[@]}" >&2 || return 1; fi
    if [ "${#alone[@]}" -gt 0 ]; then "${pip[@]}" --no-deps "${alone[@]}" >&2 || return 1; fi
}

# From Python 3.13 on pip cannot install dm-control as it is: it requires labmaze, which has no wheel there and which
# nothing but dm_control.locomotion imports. It is tried without, once an environment.
see_to_dm_control() { # python
    local python="$1" missing
    mapfile -t missing < <(missing_for_dm_control)
    if [ "${#missing[@]}" -gt 0 ] && [ ! -e "$venv/.dm-control-tried" ]; then
        touch "$venv/.dm-control-tried"
        say "Installing dm-control without labmaze, which has no wheel for this Python"
        if install_dm_control "$python" "${missing[@]}"; then mapfile -t missing < <(missing_for_dm_control); fi
    fi
    if [ "${#missing[@]}" -gt 0 ]; then
        say "No tensegrity_mj.learning.dm_control, since these could not be installed: ${missing[*]}. Everything else runs." \
            "To try again: $venv/bin/tensegrity-mj doctor names the commands."
    fi
}

can_draw() {
    "$venv/bin/python" -c 'import sys
from tensegrity_mj.commands.doctor import check_opengl
sys.exit(not check_opengl().works)' >/dev/null 2>&1
}

apt_install() {
    local sudo=()
    command -v apt-get >/dev/null || return 1
    if [ "$(id -u)" -ne 0 ]; then
        command -v sudo >/dev/null && sudo -n true 2>/dev/null || return 1
        sudo=(sudo -n)
    fi
    say "Installing the system libraries for off-screen OpenGL: $*"
    local apt=("${sudo[@]}" env DEBIAN_FRONTEND=noninteractive timeout 300 apt-get -qq
        -o Acquire::Retries=1 -o Acquire::http::Timeout=20 -o DPkg::Lock::Timeout=120)
    "${apt[@]}" install -y --no-install-recommends "$@" >/dev/null 2>&1 </dev/null ||
        { "${apt[@]}" update >/dev/null 2>&1 </dev/null &&
            "${apt[@]}" install -y --no-install-recommends "$@" >/dev/null 2>&1 </dev/null; }
}

# Off-screen OpenGL is needed for video only; apt-get is tried once an environment, and what works is not tried again.
see_to_opengl() {
    local packages=(libegl1 libegl-mesa0 libgl1-mesa-dri libopengl0) works="$venv/.opengl-works"
    if [ -e "$works" ]; then return; fi
    if can_draw; then touch "$works" && return; fi
    if [ ! -e "$venv/.opengl-tried" ]; then
        touch "$venv/.opengl-tried"
        if apt_install "${packages[@]}" && can_draw; then touch "$works" && return; fi
    fi
    say "No video: off-screen OpenGL is missing. On Debian: apt-get install ${packages[*]}. Everything else runs."
}

# Else the first run of each engine would wait for it. Where no code is newer than the last time, there is nothing to do.
see_to_compiling() {
    local done="$venv/.compiled" code=("$root/tensegrity_mj" "$root/controllers" "$root/scripts")
    if [ -n "$compiling" ] && [ "$BASHPID" = $$ ]; then # it has begun beside the installation
        wait "$compiling" || true
        compiling=
    fi
    if [ -e "$done" ] && [ -z "$(find "${code[@]}" -name '*.py' -newer "$done" -print -quit)" ]; then return; fi
    touch "$done.begun"
    # Alone: installing and then lint have the other core, and two processes take more CPU time than one.
    if "$venv/bin/python" "$root/scripts/compile_ahead.py" --alone; then
        mv "$done.begun" "$done"
    else
        say "Compiling failed; what a run needs is compiled when it is first run. tensegrity-mj doctor says what is wrong."
    fi
}

set_up() { # run|docs|dev
    local python
    python="$(find_python)" || exit 1
    install_package "$python" "$1"
    see_to_dm_control "$python"
    see_to_opengl
}
