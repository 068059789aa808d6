#!/bin/sh
# Makes .venv with the package and everything it needs, on a new Debian or Ubuntu machine too.
# PYTHON chooses the interpreter; by default the first that is new enough is taken.
set -eu
cd "$(dirname "$0")/.."

new_enough() {
    "$1" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null
}

find_python() {
    for candidate in ${PYTHON:-python3 python3.13 python3.12 python3.11}; do
        if new_enough "$candidate"; then
            echo "$candidate"
            return
        fi
    done
}

# Debian keeps ensurepip, which venv needs, in a package of its own.
missing_python_packages() {
    if [ -n "$python" ]; then
        "$python" -c 'import ensurepip' 2>/dev/null ||
            "$python" -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])'
    elif command -v python3 >/dev/null 2>&1; then
        echo "python3.11 python3.11-venv"
    else
        echo "python3 python3-venv"
    fi
}

# What Open3D links to.
missing_libraries() {
    for package in libegl1 libgl1 libgomp1 libidn2-0 libstdc++6 libudev1 libusb-1.0-0 libx11-6; do
        dpkg -s "$package" >/dev/null 2>&1 || echo "$package"
    done
}

install_system_packages() {
    if ! command -v dpkg >/dev/null 2>&1 || ! command -v apt-get >/dev/null 2>&1; then
        echo "Not a Debian or Ubuntu machine: Open3D needs EGL, GL, IDN2, USB 1.0 and X11." >&2
        return
    fi
    packages=$({ missing_python_packages; missing_libraries; } | xargs)
    [ -n "$packages" ] || return 0
    if [ "$(id -u)" -ne 0 ]; then
        echo "System packages are missing. Run this, then the same make command again:" >&2
        echo "    sudo apt-get update && sudo apt-get install -y $packages" >&2
        exit 1
    fi
    echo "Installing system packages: $packages"
    apt-get update -qq
    # shellcheck disable=SC2086
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $packages >/dev/null
}

python=$(find_python)
if [ -n "${PYTHON:-}" ] && [ -z "$python" ]; then
    echo "PYTHON=$PYTHON isn't Python 3.11 or newer" >&2
    exit 1
fi
install_system_packages
python=$(find_python)
if [ -z "$python" ]; then
    echo "Python 3.11 or newer is needed; install it and set PYTHON=/path/to/it" >&2
    exit 1
fi
test -x .venv/bin/pip || "$python" -m venv .venv
echo "Installing packages into .venv (some minutes the first time)"
.venv/bin/pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
touch .venv/.ready
