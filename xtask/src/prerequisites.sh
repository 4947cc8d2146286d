# Functions for the probes in prerequisites.rs. A probe runs in an empty folder of its own and ends
# at the first command that fails; what it prints is shown.
set -e
case ${SINGLETRACK_RUSTC-} in
/*) ;;
*/*) SINGLETRACK_RUSTC=$PWD/$SINGLETRACK_RUSTC ;;
esac
debian=/usr/bin/rustc
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"

fail() {
    echo "$*" >&2
    exit 1
}

# links COMPILER SOURCE OPTION...: links a program from C.
links() {
    compiler=$1
    printf '%s\n' "$2" >probe.c
    shift 2
    # CC may have a wrapper before the compiler.
    $compiler probe.c -o probe "$@"
}

# emulates PREFIX EMULATOR: runs a program for another processor, which ends with status 42.
emulates() {
    links "$1-gcc" '#include <stdlib.h>
int main(void) { exit(42); }'
    status=0
    "$2" -L "/usr/$1" ./probe || status=$?
    [ $status -eq 42 ] || fail "$2 does not run a program: status $status"
    "$2" --version
}

# Prints a Python that creates environments: the one in the path, or Debian's.
find_python() {
    for python in python3 /usr/bin/python3; do
        if "$python" -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
            echo "$python"
            return
        fi
    done
    fail "neither python3 ($(python3 --version 2>&1)) nor /usr/bin/python3 is 3.11 or later, with venv and ensurepip"
}

release() {
    "$@" -vV 2>/dev/null | sed -n 's/^release: //p'
}

minor() {
    echo "$1" | cut -d. -f2
}

# Candidates for compiler: the named one is not replaced by another.
candidates() {
    if [ "${SINGLETRACK_RUSTC-}" ]; then
        command -v "$SINGLETRACK_RUSTC" || fail "SINGLETRACK_RUSTC names $SINGLETRACK_RUSTC, which does not run"
        return
    fi
    rustup toolchain list 2>/dev/null | sed -n 's/^\(nightly[^ ]*\).*/\1/p' >nightlies || true
    while read -r toolchain; do
        rustup which --toolchain "$toolchain" rustc 2>/dev/null </dev/null || true
    done <nightlies
    echo "$debian"
}

# compiler TRIPLE LIBRARY [clippy]: the first compiler that builds for a target, which may lack the
# back end, from the sources of a library. Prints a description, its path, and the path of the cargo
# beside it if that is of the same release: it matches the layout of the sources.
compiler() {
    candidates >candidates
    while read -r rustc; do
        if (attempt "$rustc" "$@") </dev/null 2>>reasons; then
            return
        fi
    done <candidates
    fail "$(cat reasons)"
}

attempt() {
    release=$(release "$1")
    [ "$release" ] || fail "$1 does not run"
    [ "$(minor "$release")" -ge "$(minor "$OLDEST")" ] || fail "$1, rustc $release, is older than $OLDEST"
    case $2 in
    avr-*) cpu=-Ctarget-cpu=atmega328p ;;
    *) cpu= ;;
    esac
    echo '#![feature(no_core)] #![allow(internal_features)] #![no_core]' >nothing.rs
    RUSTC_BOOTSTRAP=1 "$1" --crate-type=lib --target "$2" $cpu --emit=obj=nothing.o nothing.rs >errors 2>&1 ||
        fail "$1, rustc $release, can't compile for $2: $(grep -m1 ^error errors)"
    sources=$("$1" --print sysroot)/lib/rustlib/src/rust/library/$3
    [ -e "$sources/src/lib.rs" ] || fail "$1, rustc $release, lacks the sources of $3 in $sources"
    bin=${1%/*}
    if [ "$4" ]; then
        clippy=$(release "$bin/clippy-driver" --rustc)
        [ "$clippy" = "$release" ] || fail "$bin/clippy-driver is of rustc ${clippy:-(it does not run)}, the compiler is $release"
    fi
    printf 'rustc %s, %s\n%s\n' "$release" "$1" "$1"
    cargo=$(release "$bin/cargo")
    [ "$(minor "$cargo")" != "$(minor "$release")" ] || echo "$bin/cargo"
}

# Installs or upgrades Debian packages, without removing any.
install_packages() {
    command -v apt-get >/dev/null || fail "There is no apt-get here."
    sudo=
    if [ "$(id -u)" != 0 ]; then
        sudo -n true 2>/dev/null || fail "Installing packages needs root, and sudo asks for a password: install them by hand."
        sudo="sudo -n"
    fi
    # apt waits for dpkg's lock, but not for that of the lists. By default, a list that can't be
    # fetched is a warning.
    for _ in 1 2 3 4 5 6 7 8 9 10; do
        rm -f errors
        apt update --error-on=any && break
        grep -q 'Could not get lock' log || break
        sleep 3
    done
    # Older lists may do. A package that this distribution lacks does not prevent the others.
    if ! apt install "$@" && ! grep -qi 'fetch\|lock' log; then
        for package; do
            apt install "$package" || true
        done
    fi
    [ ! -e errors ] || fail "$(sort -u errors)"
}

# The timeouts are for servers that do not answer.
apt() {
    $sudo env DEBIAN_FRONTEND=noninteractive apt-get -qq --yes --no-install-recommends --no-remove \
        -o Dpkg::Use-Pty=0 -o DPkg::Lock::Timeout=60 -o Acquire::Retries=0 \
        -o Acquire::http::Timeout=8 -o Acquire::https::Timeout=8 "$@" >log 2>&1 && return
    { grep ^E: log || tail -n 1 log; } | sed "s/^/apt-get $1: /" >>errors
    return 1
}
