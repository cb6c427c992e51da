#!/usr/bin/env bash
# Makes LinuxCNC usable for the acceptance test: Debian's linuxcnc-uspace without recommended
# packages, and an ordinary user to run it as, because its realtime process refuses root.
# Quiet and idempotent. Exit codes: 0 ready, 75 the package cannot be installed here.
set -euo pipefail

readonly PACKAGE=linuxcnc-uspace
readonly CNC_USER="${METROSEP_CNC_USER:-metrosep-cnc}"
readonly UPDATE_LIMIT=90s INSTALL_LIMIT=300s

cannot() {
    echo "linuxcnc: $PACKAGE cannot be installed here: $1" >&2
    exit 75
}

as_root() {
    if [ "$(id -u)" -eq 0 ]; then "$@"; else sudo -n "$@"; fi
}

may_be_root() {
    [ "$(id -u)" -eq 0 ] || { command -v sudo && sudo -n true; } >/dev/null 2>&1
}

ready() {
    command -v linuxcnc && command -v halcmd && /usr/bin/python3 -c 'import linuxcnc, hal'
} >/dev/null 2>&1

apt() {
    as_root timeout "$1" env DEBIAN_FRONTEND=noninteractive apt-get -qq \
        -o DPkg::Lock::Timeout=60 -o Acquire::Retries=1 -o Acquire::http::Timeout=20 \
        "${@:2}" >>"$log" 2>&1
}

install_package() {
    command -v apt-get >/dev/null || cannot "there is no apt-get, so this is not a Debian system"
    may_be_root || cannot "installing needs root (or sudo without a password)"
    log="$(mktemp)"
    trap 'rm -f "$log"' EXIT
    # A mirror that is half out of reach may still have the package: only the install decides.
    apt "$UPDATE_LIMIT" update || true
    apt "$INSTALL_LIMIT" install --yes --no-install-recommends "$PACKAGE" ||
        cannot "apt-get says: $(grep -a . "$log" | tail -n 1)"
    ready || cannot "apt-get succeeded but linuxcnc or its Python modules do not start"
}

create_user() {
    if [ "$(id -u)" -ne 0 ] || id "$CNC_USER" >/dev/null 2>&1; then
        return # an ordinary user runs LinuxCNC as itself
    fi
    useradd --no-create-home --home-dir /nonexistent --shell /bin/sh "$CNC_USER"
}

ready || install_package
create_user
