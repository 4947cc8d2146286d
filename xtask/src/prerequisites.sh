#!/usr/bin/env bash
# Prerequisites of the builds and checks, and their probes.
#
#     xtask/src/prerequisites.sh ensure PART...         probes what the parts need, and installs packages
#     xtask/src/prerequisites.sh find PROBE [ARGUMENT...]   prints what a probe finds
#
# Both print on standard output why they fail. The packages are those of packaging/prerequisites.
set -euf
case ${SINGLETRACK_RUSTC-} in
/*) ;;
*/*) SINGLETRACK_RUSTC=$PWD/$SINGLETRACK_RUSTC ;;
esac
root=$(cd "$(dirname "$0")/../.." && pwd)
script=$root/xtask/src/prerequisites.sh
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"

# The parts of `cargo verify --without`, in the order in which messages name them.
optional="uno odroid readers python ros zenoh octave browser web slurm units debian"

nightly="rustup toolchain install nightly --component rust-src,clippy
or name one: SINGLETRACK_RUSTC=/path/to/rustc"

# row PARTS NAME PACKAGES PROBE [HINT]: what these parts need, its part in packaging/prerequisites, its
# probe, and how to get it without the packages. Beside those of `cargo verify`, `image` is the part of
# everything that runs the Arduino's image, `armhf` that of `cargo odroid`, `wasm` that of `cargo web`.
table() {
    row base "rustfmt" "" "format" "rustup component add rustfmt
or, with Debian's Rust: apt-get install rustfmt-web"
    row base "clippy" "" "clippy_matches" "rustup component add clippy
or, with Debian's Rust: apt-get install rust-web-clippy"
    row base "C compiler" base "c_compiler"
    row "uno image" "Rust for the Arduino" rust "compiler avr-none core" "$nightly"
    row "uno image" "C and binutils for the Arduino" uno "c_for_uno"
    row "uno image" "simavr" uno "simavr"
    row "odroid armhf" "Rust for the Odroid" rust "compiler armv7-unknown-linux-gnueabihf std" "$nightly"
    row "odroid armhf" "C for the Odroid" odroid "c_for_odroid"
    row odroid "qemu" odroid "emulates arm-linux-gnueabihf qemu-arm-static"
    row uno "clippy for the Arduino" rust "compiler avr-none core clippy" "$nightly"
    row "readers python" "Python" python "find_python"
    row ros "Python for ROS" ros "python_for_ros"
    row octave "Octave" octave "octave"
    row "web wasm" "Rust for the browser" rust "compiler wasm32-unknown-unknown std" "$nightly"
    row "web wasm" "C for the browser" web "wasm_tools"
    row web "Node" node "programs node"
    row "browser web" "Chromium" browser "chromium --headless --version"
    row slurm "Slurm" slurm "slurm"
    row units "systemd-analyze" units "systemd"
    row debian "debhelper" debian "debhelper"
    row debian "lintian" debian "programs lintian"
    row arm64 "Rust for ARM64" rust "compiler aarch64-unknown-linux-gnu std" "$nightly"
    row arm64 "C and qemu for ARM64" arm64 "emulates aarch64-linux-gnu qemu-aarch64-static"
    row flash "avrdude" flash "avrdude -?"
    row git "git" git "programs git"
    row podman "podman" podman "programs podman"
}

# Takes the rows of the wanted parts.
row() {
    local part
    for part in $1; do
        if [[ " $wanted " == *" $part "* ]]; then
            parts+=("$1") names+=("$2") packages+=("$3") probes+=("$4") hints+=("${5-}")
            return
        fi
    done
}

# ensure PART...: probes what the parts need, installs or upgrades the packages of what is not met, and
# probes this again. Ends with one message about all that remains.
ensure() {
    wanted=$*
    parts=() names=() packages=() probes=() hints=() texts=() unmet=()
    table
    probe_rows "${!names[@]}"
    local row helpful=() trouble=
    for row in "${unmet[@]}"; do
        # None replaces a named compiler.
        if [ "${packages[row]}" = rust ] && [ "${SINGLETRACK_RUSTC-}" ]; then packages[row]=; fi
        [ -z "${packages[row]}" ] || helpful+=("${packages[row]}")
    done
    if [ ${#helpful[@]} -gt 0 ]; then
        # It announces the packages on its standard output.
        trouble=$("$root/packaging/prerequisites" --upgrade "${helpful[@]}" 2>&1 >&3) || true
        probe_rows "${unmet[@]}"
    fi 3>&2
    if [ ${#unmet[@]} -gt 0 ]; then
        message "$trouble"
        exit 1
    fi
}

# Probes rows, shows what was found, and leaves those that are not met in `unmet`.
probe_rows() {
    unmet=()
    local row line
    for row; do
        try ${probes[row]} || unmet+=("$row")
        texts[row]=$text
        line=${text%%$'\n'*}
        echo "${names[row]}: ${line:-it works}" >&2
    done
}

# find PROBE...: what a probe finds, or why it fails.
find() {
    local status=0
    try "$@" || status=1
    echo "$text"
    exit $status
}

# try PROBE...: runs a probe. The output, or the reason of the failure first, is in `text`.
try() {
    local status=0
    text=$("$script" "$@" 2>errors) || status=$?
    [ $status -ne 0 ] || return 0
    # Without the place in this script, which bash prints.
    text=$(sed "s|^$script: line [0-9]*: ||" errors && echo "$text")
    [ "$text" ] || text="exit status: $status"
    return 1
}

# message TROUBLE: what was found, how to get what is needed, and why packages were not installed.
message() {
    local row part without=
    echo "${#unmet[@]} prerequisites are not met"
    for row in "${unmet[@]}"; do
        printf '\n  %s\n    found    %s\n' "${names[row]}" "$(indented "${texts[row]}")"
        [ -z "${packages[row]}" ] ||
            echo "    get it   apt-get update && apt-get install $(
                "$root/packaging/prerequisites" --list "${packages[row]}"
            )   (Debian 12)"
        [ -z "${hints[row]}" ] || echo "    get it   $(indented "${hints[row]}")"
    done
    [ -z "$1" ] || printf '\n%s\n' "$1"
    printf '\npackaging/Containerfile describes a Debian 12 image with all of them, and its use.\n'
    for part in $optional; do
        for row in "${unmet[@]}"; do
            if [[ " ${parts[row]} " == *" $part "* ]]; then
                without+=,$part
                break
            fi
        done
    done
    [ -z "$without" ] || echo "To skip the checks that need them: cargo verify --without ${without#,}"
}

# More lines of a compiler's errors do not help.
indented() {
    head -n 8 <<<"$1" | sed '2,$s/^/             /'
}

# The probes. An installed package may be too old, and a program may have been installed without a
# package: a probe uses what it looks for. Each is a process with an empty folder of its own, ends at the
# first command that fails, and prints what it found.

fail() {
    echo "$*" >&2
    exit 1
}

# programs NAME...: programs that print their versions.
programs() {
    for program; do
        $program --version
    done
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
    links "$1-gcc" 'int main(void) { exit(42); }' -include stdlib.h
    status=0
    "$2" -L "/usr/$1" ./probe || status=$?
    [ $status -eq 42 ] || fail "$2 does not run a program: status $status"
    "$2" --version
}

format() {
    ${CARGO:-cargo} fmt --version
}

clippy_matches() {
    clippy=$(${CARGO:-cargo} clippy --version)
    rustc=$(${RUSTC:-rustc} --version)
    [ "$(echo $clippy | cut -d. -f3 | cut -d' ' -f1)" = "$(minor "$rustc")" ] ||
        fail "$clippy does not match $rustc"
    echo "$clippy"
}

c_compiler() {
    links "${CC:-cc}" 'int main(void) { return puts("") < 0; }' -include stdio.h
    echo "${CC:-cc} links a program"
}

c_for_uno() {
    links avr-gcc 'int main(void) { return PORTB; }' -include avr/io.h -mmcu=atmega328p
    programs avr-gcc avr-nm avr-size avr-objcopy
}

# The static library, as in the simulator.
simavr() {
    links "${CC:-cc}" 'int main(void) { return !avr_make_mcu_by_name("atmega328p"); }' \
        -I/usr/include/simavr -include sim_avr.h -l:libsimavr.a -lelf
    ./probe || fail "a program can not make an ATmega328P"
    echo "creates an ATmega328P"
}

c_for_odroid() {
    links arm-linux-gnueabihf-gcc 'int main(void) { exit(0); }' -include stdlib.h
    arm-linux-gnueabihf-gcc --version
}

# Prints linker, C compiler and archiver for WebAssembly. The linker must know what the compiler's LLVM
# writes: it is of the same release, or that of rustup.
wasm_tools() {
    rustc=$(compiler wasm32-unknown-unknown std | sed -n 2p)
    llvm=$("$rustc" -vV | sed -n 's/^LLVM version: \([0-9]*\).*/\1/p')
    set +f
    lld=$(ls "$("$rustc" --print sysroot)"/lib/rustlib/*/bin/rust-lld 2>/dev/null || true)
    if [ "$lld" ]; then echo "$lld"; else first "wasm-ld-$llvm"; fi
    first "clang-$llvm" clang
    first "llvm-ar-$llvm" llvm-ar
}

# first NAME...: the first program that there is.
first() {
    for program; do
        if command -v "$program" >/dev/null; then
            echo "$program"
            return
        fi
    done
    fail "there is no $*"
}

debhelper() {
    programs dpkg-architecture dpkg-deb man >/dev/null
    dh --list | grep -x installsysusers || fail "dh lacks installsysusers, which debhelper has since 13.11"
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

python_for_ros() {
    python=$(find_python)
    $python -c 'import os, sys, sysconfig
assert sys.version_info < (3, 14), "there is a rclpy up to 3.13"
header = sysconfig.get_paths()["include"] + "/Python.h"
assert os.path.exists(header), header + " is missing"'
    programs "$python" c++
    namespace
}

# A network of its own, without rights.
namespace() {
    unshare --map-root-user --net ip link
}

octave() {
    octave-cli --quiet --no-history --no-init-file --eval "pkg load instrument-control;
        jsondecode('1'); assert(exist('tcpclient') > 0); disp(OCTAVE_VERSION)"
}

# The path of a user may lack the folder of the daemons. Without a cluster, sbatch does not even print
# its version.
slurm() {
    PATH=$PATH:/usr/sbin
    slurmctld -V
    munged --version
    slurmd -V
    command -v sbatch
    namespace
}

# The unit reloads the daemon by /bin/kill.
systemd() {
    version=$(systemd-analyze --version | sed -n '1s/systemd \([0-9]*\).*/\1/p')
    [ "$version" -ge 250 ] || fail "systemd ${version:-}, not 250 or later"
    [ -x /bin/kill ] || fail "no /bin/kill, which the unit uses"
    echo "systemd $version"
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
    echo "${DEBIAN_RUSTC-/usr/bin/rustc}"
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
    oldest=$(sed -n 's/^rust-version = "\(.*\)"/\1/p' "$root/Cargo.toml")
    [ "$(minor "$release")" -ge "$(minor "$oldest")" ] || fail "$1, rustc $release, is older than $oldest"
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
    if [ "${4-}" ]; then
        clippy=$(release "$bin/clippy-driver" --rustc)
        [ "$clippy" = "$release" ] || fail "$bin/clippy-driver is of rustc ${clippy:-(it does not run)}, the compiler is $release"
    fi
    printf 'rustc %s, %s\n%s\n' "$release" "$1" "$1"
    cargo=$(release "$bin/cargo")
    [ "$(minor "$cargo")" != "$(minor "$release")" ] || echo "$bin/cargo"
}

"$@"
