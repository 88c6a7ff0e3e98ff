#!/usr/bin/env bash
# Prepares like ./effigy, builds everything and runs all tests. Arguments go to ctest (e.g. -R splat).
set -euo pipefail
root="$(cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")" && pwd)"
. "$root/scripts/prepare.sh"
ensure_packages
ensure_networks
EFFIGY_STAMP_EXTRA="$root/tests" ensure_built all
# Data that is not part of the project (docs/testing in CONTRIBUTING.md); tests that need it skip.
if [ -z "${EFFIGY_DATA:-}" ] && [ -d "$root/../shared/data" ]; then export EFFIGY_DATA="$root/../shared/data"; fi
if [ -z "${EFFIGY_SCENES:-}" ] && [ -d "$root/../shared/scenes" ]; then export EFFIGY_SCENES="$root/../shared/scenes"; fi
cd "$build_dir"
exec ctest --output-on-failure --no-tests=error "$@"
