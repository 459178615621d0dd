# Sourced by tools/demo and tools/test, with the extra to install: goes to the project's folder and makes .venv there, or reuses it.
# Usage: source tools/environment.sh convert | test
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
unset PYTHONPATH PYTHONHOME VIRTUAL_ENV

# ouster-sdk, by which the tests check Ouster's packets, asks for older releases of click and rosbags than these tests
# need: it comes without its dependencies; those that it loads stand under `test` in pyproject.toml.
# The same is true of nuscenes-devkit, which asks for numpy below 2, and of pykitti, which loads pandas and OpenCV.
ouster_sdk="ouster-sdk==1.0.1"
data_sets=(nuscenes-devkit==1.2.0 pykitti==0.3.1)
kiss_icp="kiss-icp>=1.3" # odometry, which tracks the drive of a test
oldest_click=(click==8.1.3 cloup==3.0.5) # that pyproject.toml allows; ouster-sdk asks for click below 8.1.8

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

# Debian packages that are not here: what makes an environment, what Open3D loads, and the tests' browser.
missing_packages() {
  "$1" - "$2" <<'PYTHON'
import ctypes
import shutil
import sys

try:
    import ensurepip

    ensurepip.version()
except Exception:
    print("python3-venv")
if sys.platform == "linux":
    libraries = {
        "libEGL.so.1": "libegl1",
        "libGL.so.1": "libgl1",
        "libusb-1.0.so.0": "libusb-1.0-0",
        "libgomp.so.1": "libgomp1",
    }
    for library, package in libraries.items():
        try:
            ctypes.CDLL(library)
        except OSError:
            print(package)
    if sys.argv[1] == "test":
        for program, package in {"chromium": "chromium", "chromedriver": "chromium-driver"}.items():
            if not shutil.which(program):
                print(package)
PYTHON
}

install_packages() {
  local as_root=()
  if [ "$(id -u)" != 0 ]; then
    sudo -n true 2>/dev/null || return 0
    as_root=(sudo -n)
  fi
  command -v apt-get >/dev/null || return 0
  say "installing system packages: $*"
  "${as_root[@]}" apt-get update -qq >/dev/null 2>&1 || true
  DEBIAN_FRONTEND=noninteractive "${as_root[@]}" apt-get install -y -qq "$@" >/dev/null 2>&1 || true
}

# Run a command and show the last line that it prints; all that it printed, if it fails.
show_last_line() {
  local log status=0 last="" line pid
  log=$(mktemp)
  "$@" >"$log" 2>&1 &
  pid=$!
  while kill -0 "$pid" 2>/dev/null; do
    sleep 1
    line=$(tail -n 1 "$log" | tr -d '\r' | cut -c 1-90)
    if [ -t 2 ]; then
      printf '\r\033[K  %4d s  %s' "$SECONDS" "$line" >&2
    elif [ "$line" != "$last" ]; then
      say "  $SECONDS s  $line"
    fi
    last=$line
  done
  [ ! -t 2 ] || printf '\r\033[K' >&2
  wait "$pid" || status=$?
  [ "$status" = 0 ] || cat "$log" >&2
  rm -f "$log"
  return "$status"
}

pip_install() {
  show_last_line .venv/bin/python -m pip --disable-pip-version-check --no-input install --progress-bar off "$@"
}

# Where the package's own build finds its tools, so that what is compiled once stays compiled.
build_requirements() {
  .venv/bin/python - <<'PYTHON'
import tomllib

with open("pyproject.toml", "rb") as file:
    print(*tomllib.load(file)["build-system"]["requires"], sep="\n")
PYTHON
}

more_build_requirements() {
  PYTHONPATH=tools .venv/bin/python -c 'import build_backend; print(*build_backend.get_requires_for_build_editable(), sep="\n")'
}

install_package() {
  local wanted levels=()
  mapfile -t wanted < <(build_requirements)
  # setuptools: some of the tests' packages have no wheel, and are built in this environment too.
  pip_install "${wanted[@]}" "setuptools>=70.1"
  mapfile -t wanted < <(more_build_requirements)
  [ -z "${wanted[*]}" ] || pip_install "${wanted[@]}"
  [ "$1" != test ] || levels=(--config-settings "cmake.define.LIDARCFG_LEVELS=v2;v3") # also for lesser processors
  pip_install --verbose --no-build-isolation "${levels[@]}" --editable ".${1:+[$1]}"
}

compiled_sources() {
  find lidarcfg/core -name '*.cpp' -o -name '*.h' -o -name CMakeLists.txt | sort
}

prepare() {
  local extra=$1 stamp python missing wanted
  stamp=.venv/installed${extra:+-$extra}
  wanted=$(cat pyproject.toml tools/environment.sh tools/build_backend.py && compiled_sources | xargs cat | cksum)
  python=$(find_python)
  missing=$(missing_packages "$python" "$extra" | tr '\n' ' ')
  if [ -n "$missing" ]; then
    # shellcheck disable=SC2086  # one word a package
    install_packages $missing
    missing=$(missing_packages "$python" "$extra" | tr '\n' ' ')
  fi
  [ -z "$missing" ] || say "missing, and not to be installed from here: what Debian calls $missing"
  if [ -f "$stamp" ] && [ "$(cat "$stamp")" = "$wanted" ] && .venv/bin/python -c '' 2>/dev/null; then
    return
  fi
  say "making the environment in .venv and compiling (about two minutes, once)"
  if ! .venv/bin/python -m pip --version >/dev/null 2>&1; then
    if ! "$python" -m venv --clear .venv >/dev/null 2>&1; then
      rm -rf .venv
      say "no environment can be made: $python has no working venv (Debian: apt-get install python3-venv)"
      exit 2
    fi
  fi
  install_package "$extra"
  if [ "$extra" = test ]; then
    pip_install --no-deps --target .venv/oldest-click --upgrade "${oldest_click[@]}"
    pip_install --no-deps --only-binary :all: "$ouster_sdk" ||
      say "no wheel of $ouster_sdk for this Python and system: its tests are skipped"
    pip_install --no-deps "${data_sets[@]}" || say "no ${data_sets[*]}: their tests are skipped"
    pip_install --only-binary kiss-icp "$kiss_icp" ||
      say "no wheel of $kiss_icp for this Python and system: its tests are skipped"
  fi
  printf '%s\n' "$wanted" >"$stamp"
}

prepare "${1-}"
