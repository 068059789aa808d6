#!/bin/sh
# Installs the system libraries that Open3D links to, or says which command does it.
set -eu
packages="libusb-1.0-0 libgl1 libegl1 libx11-6 libgomp1"
missing=""
for package in $packages; do
    dpkg -s "$package" >/dev/null 2>&1 || missing="$missing $package"
done
if ! python3 -c 'import ensurepip' >/dev/null 2>&1; then
    missing="$missing python3-venv"
fi
[ -n "$missing" ] || exit 0
if ! command -v apt-get >/dev/null 2>&1; then
    echo "Not a Debian or Ubuntu machine: install the equivalents of$missing, then go on." >&2
    exit 0
fi
if [ "$(id -u)" -ne 0 ]; then
    echo "System libraries are missing. Run this, then the same make command again:" >&2
    echo "    sudo apt-get update && sudo apt-get install -y$missing" >&2
    exit 1
fi
echo "Installing system libraries:$missing"
apt-get update -qq
# shellcheck disable=SC2086
DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $missing
