#!/usr/bin/env bash
# Makes headless Chromium usable for the browser tests. Quiet and idempotent.
# Exit codes: 0 ready, 75 it cannot be installed here.
set -euo pipefail

cd "$(dirname "${BASH_SOURCE[0]}")/../.."
python="${1:-python3}"

cannot() {
    echo "browser: Chromium cannot be installed here: $1" >&2
    exit 75
}

as_root() {
    if [ "$(id -u)" -eq 0 ]; then "$@"; else sudo -n "$@"; fi
}

"$python" tools/chromium.py && exit 0
command -v apt-get >/dev/null || cannot "there is no apt-get, so this is not a Debian system"
[ "$(id -u)" -eq 0 ] || sudo -n true 2>/dev/null || cannot "installing needs root (or sudo without a password)"
log="$(mktemp)"
trap 'rm -f "$log"' EXIT
apt() {
    as_root timeout "$1" env DEBIAN_FRONTEND=noninteractive apt-get -qq \
        -o DPkg::Lock::Timeout=120 -o Acquire::Retries=1 -o Acquire::http::Timeout=20 \
        "${@:2}" >>"$log" 2>&1
}
# A mirror that is half out of reach may still have the package: only the install decides.
apt 90s update || true
apt 300s install --yes --no-install-recommends chromium || {
    tail -n 5 "$log" >&2
    cannot "apt-get could not install the package chromium"
}
"$python" tools/chromium.py || cannot "the package is there, but no program of it"
