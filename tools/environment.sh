# Sourced by tools/demo and tools/test: goes to the project's folder and makes .venv there, or reuses it.
# Usage: source tools/environment.sh "" | test
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
unset PYTHONPATH PYTHONHOME VIRTUAL_ENV

say() { printf '%s\n' "$*" >&2; }

find_python() {
  local name
  for name in python3 python3.14 python3.13 python3.12 python3.11; do
    if "$name" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 14))' 2>/dev/null; then
      echo "$name"
      return
    fi
  done
  say "lidarcfg needs Python 3.11 to 3.14; none of them is on the PATH"
  exit 2
}

# Debian packages that are not here: what makes an environment, and what Open3D loads.
missing_packages() {
  "$1" -c 'import ensurepip' 2>/dev/null || echo python3-venv
  [ "$(uname -s)" = Linux ] || return 0
  local pair
  for pair in libEGL.so.1:libegl1 libGL.so.1:libgl1 libusb-1.0.so.0:libusb-1.0-0 libgomp.so.1:libgomp1; do
    "$1" -c 'import ctypes, sys; ctypes.CDLL(sys.argv[1])' "${pair%%:*}" 2>/dev/null || echo "${pair##*:}"
  done
}

install_packages() {
  local as_root=()
  if [ "$(id -u)" != 0 ]; then
    if ! sudo -n true 2>/dev/null; then
      say "system libraries are missing and this user may not install them: sudo apt-get install $*"
      return
    fi
    as_root=(sudo -n)
  fi
  if ! command -v apt-get >/dev/null; then
    say "system libraries are missing and there is no apt-get; install what Debian calls: $*"
    return
  fi
  say "installing system libraries: $*"
  "${as_root[@]}" apt-get update -qq >&2 || true
  if ! DEBIAN_FRONTEND=noninteractive "${as_root[@]}" apt-get install -y -qq "$@" >/dev/null; then
    say "system libraries could not be installed: $*"
  fi
}

prepare() {
  local extra=$1 stamp python missing
  stamp=.venv/installed${extra:+-$extra}
  if [ -f "$stamp" ] && cmp -s "$stamp" pyproject.toml; then
    return
  fi
  python=$(find_python)
  missing=$(missing_packages "$python")
  # shellcheck disable=SC2086  # one word a package
  [ -z "$missing" ] || install_packages $missing
  say "making the environment in .venv (about a minute, once)"
  [ -x .venv/bin/python ] || "$python" -m venv .venv
  .venv/bin/python -m pip install --quiet --quiet --disable-pip-version-check --editable ".${extra:+[$extra]}" >&2
  cp pyproject.toml "$stamp"
}

prepare "${1-}"
