# Sourced by ./effigy and ./test.sh: installs what is missing, fetches the free networks, builds what
# changed. Everything it says goes to standard error; it is silent when there is nothing to do.
# Needs: root (the checkout). EFFIGY_NO_INSTALL=1: only name what is missing.

say() { printf 'effigy: %s\n' "$*" >&2; }
fail() { say "$*"; exit 1; }

build_dir="$root/build/release"
npm_dir="$root/build/npm"

as_root() {
  if [ "$(id -u)" = 0 ]; then "$@"; elif command -v sudo >/dev/null; then sudo "$@"
  else fail "installing packages needs root: run 'apt-get install $missing' as root, then try again."; fi
}

packages() { sed -e 's/#.*//' -e 's/[[:space:]]*$//' -e '/^$/d' "$root/scripts/packages.txt"; }

ensure_packages() {
  local stamp="$root/build/.packages"
  [ "$stamp" -nt "$root/scripts/packages.txt" ] && return 0
  command -v dpkg-query >/dev/null || fail "this launcher installs Debian packages; on another system install what scripts/packages.txt names and run cmake --preset release."
  local wanted missing=""
  wanted=$(packages)
  local p
  for p in $wanted; do
    dpkg-query -W -f '${Status}' "$p" 2>/dev/null | grep -q '^install ok installed' || missing="$missing $p"
  done
  missing="${missing# }"
  if [ -n "$missing" ]; then
    if [ "${EFFIGY_NO_INSTALL:-0}" = 1 ]; then
      fail "missing Debian packages: $missing (EFFIGY_NO_INSTALL=1: nothing was installed)."
    fi
    say "installing Debian packages: $missing"
    local log="$root/build/install.log"
    mkdir -p "$root/build"
    { as_root apt-get update -qq &&
      as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $missing; } \
      >"$log" 2>&1 || { tail -n 5 "$log" >&2; fail "the packages could not be installed (see build/install.log)."; }
  fi
  mkdir -p "$root/build"
  touch "$stamp"
}

# The MediaPipe networks (Apache-2.0), pinned by version and hash in scripts/npm/package-lock.json.
# Only 'track' needs them, so that without a network everything else still works.
ensure_networks() {
  local stamp="$npm_dir/.complete"
  [ "$stamp" -nt "$root/scripts/npm/package-lock.json" ] && return 0
  if [ "${EFFIGY_NO_INSTALL:-0}" = 1 ]; then
    say "the tracking networks are not fetched (EFFIGY_NO_INSTALL=1)."
    return 0
  fi
  if ! command -v npm >/dev/null; then
    say "installing Debian packages: npm"
    missing="npm"
    as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends npm \
      >>"$root/build/install.log" 2>&1 || { say "npm could not be installed; 'effigy track' will ask for --models."; return 0; }
  fi
  say "fetching the tracking networks from npm (about 12 MB)"
  mkdir -p "$npm_dir"
  cp "$root/scripts/npm/package.json" "$root/scripts/npm/package-lock.json" "$npm_dir/"
  if (cd "$npm_dir" && npm ci --ignore-scripts --no-audit --no-fund --loglevel=error) >"$root/build/npm.log" 2>&1; then
    touch "$stamp"
  else
    say "the tracking networks could not be fetched (see build/npm.log); 'effigy track' will ask for --models."
  fi
}

# ensure_built TARGET...: configures once, then builds when a source is newer than the last build.
ensure_built() {
  local stamp="$build_dir/.built-$1"
  if [ -f "$stamp" ] && [ -z "$(find "$root/src" "$root/bench" "$root/cmake" "$root/CMakeLists.txt" \
        ${EFFIGY_STAMP_EXTRA:-} -newer "$stamp" -print -quit)" ]; then
    return 0
  fi
  local log="$root/build/build.log" begin
  begin=$(date +%s)
  touch "$build_dir.stamp-next" 2>/dev/null || { mkdir -p "$root/build"; touch "$build_dir.stamp-next"; }
  if [ ! -f "$build_dir/build.ninja" ]; then
    say "configuring"
    (cd "$root" && cmake --preset release) >"$log" 2>&1 || { grep -m 5 -A 4 'CMake Error' "$log" >&2; fail "configuring failed (see build/build.log)."; }
  fi
  say "building (several minutes the first time)"
  cmake --build "$build_dir" --target "$@" >"$log" 2>&1 || { grep -m 5 -A 4 -E 'error|FAILED' "$log" >&2; fail "the build failed (see build/build.log)."; }
  mv "$build_dir.stamp-next" "$stamp"
  say "built in $(( $(date +%s) - begin )) s"
}

export EFFIGY_NPM="$npm_dir/node_modules"
